"""Places at which an artefact is put down by hand, on the table and on spacers, and its orientations there."""

from __future__ import annotations

import math

import numpy as np

from agent.planning.new_machine.artefact_setup import ArtefactSetup
from agent.planning.new_machine.fields import PLACEMENT
from agent.planning.new_machine.machine_setup import PROPOSED, STATED, MachineSetup, Triple
from agent.planning.new_machine.station_setup import (
    BEFORE_TOUCH_MM,
    TABLE_BELOW_MM,
    StationSetup,
    outer_stations,
    propose_stations,
)
from agent.settings.schema import ProcedureSettings
from drivers.errors import InputError
from twin.artefact.artefact import Artefact
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.artefact.position_set import CHECKABLE_BALLS, Pose, Position
from twin.collision.bodies import artefact_bodies
from twin.collision.probe_frame import VERTICAL
from twin.units import S_PER_MIN

MOST_PLACES = 2
"""Places side by side on the table: a person puts the artefact down in each position."""
AZIMUTHS_DEG = (0.0, 45.0, 90.0, -45.0)
HELD_OUT_AZIMUTHS_DEG = (20.0, -70.0, -20.0, 70.0)
TOLERANCE = PlacementTolerance(5.0, 1.5)
"""Tolerance of a placement, as in the settings."""
LEAST_SPACER_MM = 20.0
SPACER_STEP_MM = 10.0
LIFT_MM = 10.0
"""Travel above a ball by which the tip is lifted after it was located."""
SEARCHED_MM = 10.0
"""Travel across the stylus for the search of a ball beside its place."""
FEED_STEP_MM_PER_MIN = 50.0
BRAKING_SHARE = 0.5
"""Proposed braking distance of the search, as a share of the one at which the tip reaches the holder of a ball."""


def propose_hand_places(
    machine: MachineSetup,
    setup: ArtefactSetup,
    artefact: Artefact,
    *,
    count: int | None = None,
    first_mm: Triple | None = None,
    table_z_mm: float | None = None,
) -> StationSetup:
    """Return the places of the origin of the artefact frame: side by side along the longest horizontal axis on the
    table, and above these on spacers if the vertical travel has room for them.

    The places are so far from the ends of the travel that enough balls are within reach at them. A proposed table is so
    low that the artefact on it can be touched from above. `count` (of all places), `first_mm` (place 1) and
    `table_z_mm` replace proposals; an artefact may then be too high (`room_above_mm`). Raises InputError if the stylus
    does not point down.
    """
    if not machine.spindle.is_vertical or machine.spindle.sign > 0:
        raise InputError(
            "an artefact that is placed by hand needs a stylus that points down, which comes down on it",
            hint="state --spindle -Z, or a mount with --placement mount",
            option=PLACEMENT.flag,
        )
    low, _ = machine.stylus_range(VERTICAL)
    bodies = artefact_bodies(artefact, Pose(np.zeros(3), np.eye(3)))
    below_mm = -min(body.shape.lower[VERTICAL] for body in bodies)
    highest_base_mm = _highest_place_mm(machine, artefact)
    proposed_table = math.floor(min(low - TABLE_BELOW_MM, highest_base_mm - below_mm))
    table = float(proposed_table) if table_z_mm is None else table_z_mm
    base = math.ceil(10.0 * (table + below_mm)) / 10.0 if first_mm is None else first_mm[VERTICAL]
    spacer_mm = SPACER_STEP_MM * math.floor((highest_base_mm - base) / SPACER_STEP_MM)
    heights = (0.0, spacer_mm) if spacer_mm >= LEAST_SPACER_MM and count != 1 else (0.0,)
    side_by_side = MOST_PLACES if count is None else math.ceil(count / len(heights))
    across = propose_stations(
        machine,
        setup,
        count=side_by_side,
        first_mm=first_mm,
        shaft_mm=0.0,
        least_inset_mm=_least_inset_mm(machine, artefact),
    )
    # On a short travel, all of them are in its middle.
    beside = across.places_mm if count is not None else tuple(dict.fromkeys(across.places_mm))
    places = [(x, y, base + height) for height in heights for x, y, _ in beside]
    return StationSetup(
        places_mm=tuple(places if count is None else places[:count]),
        shaft_mm=0.0,
        table_z_mm=table,
        pedestal_radius_mm=0.0,
        head_mm=0.0,
        elevation_deg=0.0,
        origins={
            "places_mm": PROPOSED if first_mm is None else STATED,
            "table_z_mm": PROPOSED if table_z_mm is None else STATED,
        },
        by_hand=True,
        search_feed_mm_per_min=_search_feed_mm_per_min(machine, artefact),
    )


def room_above_mm(machine: MachineSetup, stations: StationSetup, artefact: Artefact) -> float:
    """Return how much higher the lowest place could be, in mm; negative if the artefact there is too high to be touched
    from above."""
    return _highest_place_mm(machine, artefact) - min(place[VERTICAL] for place in stations.places_mm)


def hand_positions(stations: StationSetup) -> tuple[Position, ...]:
    """Return the proposed orientations at each place, within reach or not."""
    return tuple(
        Position(station, azimuth, 0.0) for station in range(1, len(stations.places_mm) + 1) for azimuth in AZIMUTHS_DEG
    )


def held_out_azimuths(count: int | None) -> tuple[float, ...]:
    """Return the azimuths in degrees in which the first table is proved: three, or four if `count` positions are
    needed to show the predicted improvement."""
    return HELD_OUT_AZIMUTHS_DEG[: 3 if count is None else 4]


def proving_stations(machine: MachineSetup, stations: StationSetup, count: int | None) -> tuple[int, ...]:
    """Return the numbers of the places at which the first table is proved: the outer ones, or all for more than eight
    positions."""
    if count is not None and count > 2 * len(HELD_OUT_AZIMUTHS_DEG):
        return tuple(range(1, len(stations.places_mm) + 1))
    return outer_stations(machine, stations)


def _before_mm(machine: MachineSetup, artefact: Artefact) -> float:
    """Return the travel in mm that the first touch of a ball needs above its centre."""
    return artefact.ball_radius_mm + machine.probe["tip_radius_mm"] + BEFORE_TOUCH_MM


def _highest_place_mm(machine: MachineSetup, artefact: Artefact) -> float:
    """Return the greatest height in mm, workpiece frame, of a place at which all balls can be touched from above."""
    _, high = machine.stylus_range(VERTICAL)
    return high - _before_mm(machine, artefact) - LIFT_MM - float(artefact.balls[:, VERTICAL].max())


def _across_mm(machine: MachineSetup, artefact: Artefact) -> float:
    """Return the travel in mm that is needed on each side of the nominal place of a ball, across the stylus."""
    farthest_mm = float(np.linalg.norm(artefact.balls, axis=1).max())
    return _before_mm(machine, artefact) + TOLERANCE.displacement_mm(farthest_mm) + SEARCHED_MM


def _least_inset_mm(machine: MachineSetup, artefact: Artefact) -> float:
    """Return the least distance in mm of a place from the end of the travel at which so many balls are within reach
    that a wrong touch among them can be told, with the artefact along the axis of the places."""
    along = np.sort(artefact.balls[:, 0])
    count = min(CHECKABLE_BALLS, len(along))
    return _across_mm(machine, artefact) + max(float(along[count - 1]), -float(along[-count]))


def _search_feed_mm_per_min(machine: MachineSetup, artefact: Artefact) -> float | None:
    """Return the feed in mm/min at which the tip looks for a ball and stops well before its holder; None if the default
    of the settings is not too fast for the slowest axis."""
    free_mm = artefact.ball_radius_mm - artefact.body.holder_radius_mm
    fastest = math.sqrt(2.0 * min(machine.acceleration_mm_per_s2) * BRAKING_SHARE * max(free_mm, 0.0)) * S_PER_MIN
    if fastest >= ProcedureSettings().guarded_feed_mm_per_min:
        return None
    return max(FEED_STEP_MM_PER_MIN, FEED_STEP_MM_PER_MIN * math.floor(fastest / FEED_STEP_MM_PER_MIN))
