"""Rules of the measuring procedure, derived from the settings: probing of a ball, checks before a run, measuring layout
and safe paths.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from agent.files import translated
from agent.planning.stations import Artefacts, bodies_around, park_distance_mm, placement_tolerance, station_change
from agent.planning.time_model import time_model
from agent.probing.hand_placement import search_columns
from agent.probing.paths.free_paths import FreePathRules
from agent.probing.paths.retreat import Retreat
from agent.probing.preparation import Preparation
from agent.probing.probe_check import ProbeCheck
from agent.probing.probing_parameters import BallLimits, FastTouch, ProbingParameters, Search
from agent.probing.qualification import QualificationRules
from agent.probing.reversal import ReversalCheck
from agent.settings.schema import ProcedureSettings, QualificationSettings, Settings, StationSettings, TimingSettings
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.artefact.touch_pattern import QUALIFYING_RINGS, approach_directions, ring_directions
from twin.collision.free_paths import AxisDynamics
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_frame import ProbeFrame
from twin.immutable import SharedValues
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_description import MachineDescription
from twin.units import MM_PER_UM

# A service prepares the same machine again for each run and each preview. Which balls are accessible, and the paths
# between them, are found once. A machine has two layouts, one of them with the touches of a qualification.
_LAYOUTS: SharedValues[MeasuringLayout] = SharedValues(8)


def probing_of(
    chosen: ProcedureSettings, tip_radius_mm: float, artefact: Artefact, frame: ProbeFrame
) -> ProbingParameters:
    """Return the parameters by which the balls of the artefact are probed. Every ball is touched from the same
    directions, which depend on the direction of the stylus in `frame`.
    """
    return ProbingParameters(
        directions=approach_directions(chosen.touches_per_ball, frame.stylus_axis),
        stylus_axis=frame.stylus_axis,
        ball_radius_mm=artefact.ball_radius_mm,
        tip_radius_mm=tip_radius_mm,
        narrow_search=Search(chosen.approach_mm, chosen.search_mm),
        wide_search=Search(chosen.wide_approach_mm, chosen.wide_search_mm),
        feed_mm_per_s=chosen.touch_feed_mm_per_min / 60.0,
        retract_mm=chosen.retract_mm,
        touch_sigma_mm=chosen.touch_sigma_um * MM_PER_UM,
        limits=BallLimits(
            chosen.radius_limit_um * MM_PER_UM,
            chosen.form_limit_um * MM_PER_UM,
            chosen.touch_limit_um * MM_PER_UM,
            chosen.pole_limit_um * MM_PER_UM,
        ),
        recentre_mm=chosen.recentre_mm,
        repeats=chosen.repeats,
        stop_on_failure=chosen.on_failure == "stop",
        guarded_feed_mm_per_s=chosen.guarded_feed_mm_per_min / 60.0,
        fast_touch=FastTouch(chosen.first_touch_feed_mm_per_min / 60.0, chosen.back_off_mm)
        if chosen.touch_stages == 2
        else None,
    )


def preparation_of(
    settings: Settings, machine: MachineDescription, artefacts: Artefacts, probing: ProbingParameters
) -> Preparation:
    """Return the checks that precede a run: probe check, delay of the latch, stylus qualification and reversal test.

    Raises ConfigurationError if the artefact does not have the ball that the settings name as datum ball, on which the
    checks are made.
    """
    _refuse_unknown_datum(settings.qualification, artefacts.kind)
    check, qualifying, turning = settings.probe_check, settings.qualification, settings.reversal
    dense = replace(probing, directions=ring_directions(QUALIFYING_RINGS, probing.stylus_axis))
    limit_mm = qualifying.limit_um * MM_PER_UM
    limits = BallLimits(probing.limits.radius_limit_mm, limit_mm, limit_mm, limit_mm)
    spread_mm = qualifying.ball_radius_sigma_um * MM_PER_UM
    rules = QualificationRules(dense.directions, qualifying.ball, qualifying.pretravel_map, limits, spread_mm)
    return Preparation(
        check=ProbeCheck(check.touches, check.limit_um * MM_PER_UM) if check.enabled else None,
        qualification=rules if qualifying.enabled else None,
        layout=layout_of(settings, machine, artefacts, dense),
        reversal=ReversalCheck(turning.touches, turning.limit_um * MM_PER_UM, turning.on_excess == "stop")
        if turning.enabled
        else None,
        latch_touches=check.touches if check.latch_delay else 0,
    )


def _refuse_unknown_datum(qualification: QualificationSettings, artefact: Artefact) -> None:
    ball = qualification.ball
    if ball is not None and ball >= artefact.count:
        raise ConfigurationError(
            f"the artefact has no ball {ball}",
            key="qualification.ball",
            hint=f"balls are counted from 0 to {artefact.count - 1}",
        )


def layout_of(
    settings: Settings, machine: MachineDescription, artefacts: Artefacts, probing: ProbingParameters
) -> MeasuringLayout:
    """Return the measuring layout: the places of the artefact on the machine and the axis positions within reach.

    Its limits are the travel of the axes, reduced by the travel that the touches of `probing` need around a ball.
    """
    travel, tool_mm = np.array(machine.limits), np.asarray(machine.tools[settings.tool], dtype=np.float64)
    below, above = probing.required_travel_mm
    tolerance = placement_tolerance(settings.stations)
    if tolerance is not None:
        across = _placement_margin_mm(tolerance, artefacts.all, probing)
        below, above = below + across, above + across
    with translated(ConfigurationError):
        probe = settings.probe.geometry(float(tool_mm @ probing.stylus_axis))
    layout = MeasuringLayout(
        artefact=artefacts.all,
        mount=settings.mount,
        probe=probe,
        locations_mm={n: np.array(p) for n, p in enumerate(settings.stations.places_mm, start=1)},
        tool_offset_mm=tool_mm,
        lower_mm=travel[:, 0] + below,
        upper_mm=travel[:, 1] - above,
        contact_mm=probing.contact_mm,
        approach_mm=probing.wide_search.approach_mm,
        directions=probing.directions,
        overtravel_mm=probing.fastest_mm_per_s**2 / (2.0 * min(machine.acceleration_mm_per_s2)),
        own_artefacts=artefacts.own,
        neighbours=bodies_around(
            settings.mount, settings.stations, station_change(settings.roles, settings.stations), artefacts
        ),
        placement=tolerance,
    )
    return _LAYOUTS.shared(layout)


def _placement_margin_mm(tolerance: PlacementTolerance, artefact: Artefact, probing: ProbingParameters) -> Array:
    """Return the additional travel (3,) in mm that an artefact placed by hand needs at either end: its displacement
    within the tolerance, and the search around the place of a ball. Along the stylus, the table determines where it
    stands."""
    displaced_mm = tolerance.displacement_mm(float(np.linalg.norm(artefact.balls, axis=1).max()))
    searched_mm = max(float(np.linalg.norm(aside)) for aside in search_columns(tolerance, probing))
    return np.asarray((displaced_mm + searched_mm) * (1.0 - np.abs(probing.stylus_axis)))


def retreat_of(
    layout: MeasuringLayout,
    stations: StationSettings,
    procedure: ProcedureSettings,
    timing: TimingSettings,
    machine: MachineDescription,
) -> Retreat:
    """Return the retreat plane, a park location beside each station, and the rules of the paths of the probe.

    An artefact that is placed by hand is measured on paths above it, so there are no rules of paths between its parts.
    Each park location is within the travel of the axes. Raises ConfigurationError if there is no room for a park
    location.
    """
    along = layout.station_axis
    low, high = machine.limits[along]
    park = {}
    for number, place in enumerate(stations.places_mm, start=1):
        at = place[along]
        away = park_distance_mm(stations.park_distance_mm, at, (low, high))
        target = at + away if at + away <= high else at - away
        if not low <= target <= high:
            raise ConfigurationError(
                f"there is no room to park {away:g} mm beside station {number} along {AXES[along]}",
                key="stations.park_distance_mm",
                hint=f"the travel of {AXES[along]} is {low:g} to {high:g} mm, station {number} is at {at:g} mm",
            )
        park[number] = target
    short = procedure.paths == "shortest" and not stations.placed_by_hand
    path_rules = free_path_rules_of(procedure, timing, machine) if short else None
    frame = layout.frame
    return Retreat(
        retreat_axis=frame.axis,
        retreat_mm=frame.retreat_end(machine.limits),
        station_axis=along,
        park_mm=park,
        path_rules=path_rules,
    )


def free_path_rules_of(chosen: ProcedureSettings, timing: TimingSettings, machine: MachineDescription) -> FreePathRules:
    """Return the rules for finding short collision-free paths of the probe (free paths).

    The rules use the same speeds, accelerations and command latency as the computation of machine time.
    """
    times = time_model(machine, timing)
    travel = np.array(machine.limits)
    return FreePathRules(
        lower_mm=travel[:, 0],
        upper_mm=travel[:, 1],
        dynamics=AxisDynamics(times.rapid_mm_per_s, times.acceleration_mm_per_s2, times.command_latency_s),
        clearance_mm=chosen.clearance_mm,
        aligned_uncertainty_mm=chosen.recentre_mm,
        unaligned_uncertainty_mm=chosen.wide_approach_mm,
    )
