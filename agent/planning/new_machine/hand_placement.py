"""Places at which an artefact is put down by hand, on the table and on spacers, and its orientations there."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.planning.new_machine.artefact_setup import ArtefactSetup
from agent.planning.new_machine.fields import PLACEMENT, SIZE
from agent.planning.new_machine.machine_setup import PROPOSED, STATED, MachineSetup, Triple
from agent.planning.new_machine.station_setup import (
    BEFORE_TOUCH_MM,
    TABLE_BELOW_MM,
    StationSetup,
    outer_stations,
    propose_stations,
)
from drivers.errors import InputError
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import MIN_BALLS, Pose, Position
from twin.collision.bodies import artefact_bodies
from twin.collision.probe_frame import VERTICAL

MOST_PLACES = 2
"""Places side by side on the table: a person puts the artefact down in each position."""
AZIMUTHS_DEG = (0.0, 45.0, 90.0, -45.0)
HELD_OUT_AZIMUTHS_DEG = (20.0, -70.0, -20.0, 70.0)
TOLERANCE_MM = 5.0
TOLERANCE_DEG = 1.5
"""Tolerances of a placement, as in the settings."""
LEAST_SPACER_MM = 20.0
SPACER_STEP_MM = 10.0
LIFT_MM = 10.0
"""Travel above a ball by which the tip is lifted after it was located."""
SEARCHED_MM = 10.0
"""Travel across the stylus for the search of a ball beside its place."""


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

    `count` (of all places), `first_mm` (place 1) and `table_z_mm` replace proposals. Raises InputError if the stylus
    does not point down or the artefact is too high.
    """
    if not machine.spindle.is_vertical or machine.spindle.sign > 0:
        raise InputError(
            "an artefact that is placed by hand needs a stylus that points down, which comes down on it",
            hint="state --spindle -Z, or a mount with --placement mount",
            option=PLACEMENT.flag,
        )
    low, high = machine.stylus_range(VERTICAL)
    bodies = artefact_bodies(artefact, Pose(np.zeros(3), np.eye(3)))
    below_mm = -min(body.shape.lower[VERTICAL] for body in bodies)
    table = float(math.floor(low - TABLE_BELOW_MM)) if table_z_mm is None else table_z_mm
    base = math.ceil(10.0 * (table + below_mm)) / 10.0 if first_mm is None else first_mm[VERTICAL]
    room_mm = high - _before_mm(machine, artefact) - LIFT_MM - base - float(artefact.balls[:, VERTICAL].max())
    if room_mm < 0.0:
        raise InputError(
            f"the artefact is {-room_mm:.0f} mm too high to be touched from above on a table at Z = {table:g} mm",
            hint="state a smaller artefact or another height of the table (--table-z)",
            option=SIZE.flag,
        )
    spacer_mm = SPACER_STEP_MM * math.floor(room_mm / SPACER_STEP_MM)
    heights = (0.0, spacer_mm) if spacer_mm >= LEAST_SPACER_MM and count != 1 else (0.0,)
    side_by_side = MOST_PLACES if count is None else math.ceil(count / len(heights))
    across = propose_stations(machine, setup, count=side_by_side, first_mm=first_mm, shaft_mm=0.0)
    places = [(x, y, base + height) for height in heights for x, y, _ in across.places_mm]
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
    )


def hand_positions(
    machine: MachineSetup, stations: StationSetup, artefact: Artefact, azimuths_deg: Sequence[float] = AZIMUTHS_DEG
) -> tuple[Position, ...]:
    """Return the orientations at each place in which at least three balls are within reach wherever the artefact stands
    within its tolerance."""
    return tuple(
        Position(station, azimuth, 0.0)
        for station in range(1, len(stations.places_mm) + 1)
        for azimuth in azimuths_deg
        if _reached(machine, stations.places_mm[station - 1], artefact, azimuth) >= MIN_BALLS
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


def _reached(machine: MachineSetup, place_mm: Triple, artefact: Artefact, azimuth_deg: float) -> int:
    angle = math.radians(azimuth_deg)
    c, s = math.cos(angle), math.sin(angle)
    centres = artefact.balls @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array(place_mm)
    farthest_mm = float(np.linalg.norm(artefact.balls, axis=1).max())
    across_mm = TOLERANCE_MM + math.radians(TOLERANCE_DEG) * farthest_mm + SEARCHED_MM
    lower, upper = np.array([machine.stylus_range(axis) for axis in range(3)]).T
    before_mm = _before_mm(machine, artefact)
    margin: Array = np.array([before_mm + across_mm, before_mm + across_mm, before_mm])
    inside = (centres >= lower + margin * [1.0, 1.0, 0.0]) & (centres <= upper - margin)
    return int(inside.all(axis=1).sum())
