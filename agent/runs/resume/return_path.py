"""Path by which the machine returns after an interruption, from any position to the position at which the next step of
the run begins.

The probe is first withdrawn along the stylus. Then the mount is turned back, and the ball measured last and the one
farthest from it are measured again. Finally each axis approaches its position from the same side as before the
interruption, so that the play of the axis is taken up in the same direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agent.errors import ArtefactMoved, PlacementLost
from agent.execution.steps import (
    AskOperator,
    CheckProbe,
    MoveTo,
    OrientTo,
    Plan,
    ReadPosition,
    Record,
    Retrace,
    Step,
    TouchTowards,
)
from agent.probing.ball import LostBall, measure_ball, point
from agent.probing.hand_placement import HandPlacement
from agent.probing.position import PositionRules
from agent.probing.probing_move import met_on_the_way
from agent.probing.recovery import WITHDRAW_FEED_MM_PER_S, withdraw
from agent.probing.run_plan import is_within_position
from agent.runs.resume.step_trace import AxisMove, StepTrace
from drivers.roles import Touch
from twin.arrays import Array
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class ReturnPath:
    """Path by which the machine returns, after an interruption of a run, to the position at which the next step of the
    run begins.

    `prefix` is the beginning of the key of every step of the path. `tolerance_mm` is the largest permitted
    displacement, in mm, of a ball that is measured again.
    """

    prefix: str
    trace: StepTrace
    rules: PositionRules
    tolerance_mm: float

    def plan(self, following: Step) -> Plan[None]:
        """Move to the position at which `following`, the next step of the run, begins. Raises ArtefactMoved if the
        artefact has moved since the interruption, or PlacementLost if it was placed by hand and can be placed again."""
        trace, rules = self.trace, self.rules
        if not trace.moved:
            return
        probing = rules.probing
        yield from withdraw(rules.retreat, np.asarray(probing.stylus_axis), probing.retract_mm, trace.last_motion)
        yield CheckProbe(f"{self.prefix}/probe")
        if trace.pose is not None and not isinstance(following, (OrientTo, AskOperator)):
            yield from self._turn_mount_back(trace.pose)
            for number, (of, centre) in enumerate(trace.datums, start=1):
                key = f"{self.prefix}/datum" if number == 1 else f"{self.prefix}/datum-{number}"
                yield from self._datum(key, of, np.array(centre))
        if trace.placed and is_within_position(following.key) and not isinstance(following, AskOperator):
            yield from self._placed_datum()
        if trace.at_mm is not None:
            yield from self._approach(np.array(trace.at_mm))

    def _placed_datum(self) -> Plan[None]:
        """Find balls measured in this position of an artefact that was placed by hand.

        The artefact may have been moved or taken away, so the probe first comes down slowly until it meets something.
        Raises PlacementLost unless they are where they were.
        """
        placement, probing, retreat = self.rules.placement, self.rules.probing, self.rules.retreat
        assert placement is not None  # noqa: S101  the artefact was placed by hand
        if not self.trace.datums:
            raise PlacementLost("the run was interrupted before a ball had been measured in this position")
        for number, (of, centre) in enumerate(self.trace.datums):
            key = f"{self.prefix}/placed-{number}"
            pole = np.array(centre) - probing.stylus_axis * probing.contact_mm
            above, deepest = (
                retreat.at_retreat_plane(pole),
                pole + probing.stylus_axis * probing.narrow_search.beyond_mm,
            )
            yield from self._cross(f"{key}/over", above, placement)
            met = yield TouchTowards(f"{key}/down", point(deepest), placement.search_feed_mm_per_s)
            yield MoveTo(f"{key}/up", point(above))
            near_mm = probing.narrow_search.approach_mm
            if not isinstance(met, Touch) or math.dist(met.position_mm, pole.tolist()) > near_mm:
                raise PlacementLost(f"the ball of {of} is not where it was before the interruption")
        try:
            for number, (ball, at) in enumerate(self.trace.datums, start=1):
                datum = f"{self.prefix}/datum" if number == 1 else f"{self.prefix}/datum-{number}"
                yield from self._datum(datum, ball, np.array(at))
        except ArtefactMoved as moved:
            raise PlacementLost(moved.message) from moved

    def _cross(self, key: str, target: Array, placement: HandPlacement) -> Plan[None]:
        """Move in the retreat plane above an artefact that may have been moved. Raises PlacementLost if it is in the
        way."""
        if (yield from met_on_the_way(key, target, placement.search_feed_mm_per_s)):
            raise PlacementLost("something stands so high that the probe met it at the retreat plane")

    def _turn_mount_back(self, pose: OrientTo) -> Plan[None]:
        """Turn the mount back to `pose`. It may have sunk without power, or its turn may have been interrupted."""
        here = np.array((yield ReadPosition(f"{self.prefix}/here")))
        yield MoveTo(f"{self.prefix}/park", point(self.rules.retreat.park_location(here, pose.station)))
        yield OrientTo(f"{self.prefix}/orient", pose.station, pose.azimuth_deg, pose.elevation_deg)

    def _datum(self, key: str, of: str, expected: Array) -> Plan[None]:
        """Measure a ball found in this pose again, the one with the journal record `of`. Raises ArtefactMoved if it is
        not where it was."""
        probing, retreat = self.rules.probing, self.rules.retreat
        above = retreat.withdrawn_from(expected, probing)
        yield MoveTo(f"{key}/enter", point(retreat.at_retreat_plane(above)))
        yield MoveTo(f"{key}/approach", point(above))
        found = yield from measure_ball(key, expected, probing, probing.narrow_search)
        if isinstance(found, LostBall):
            raise self._artefact_moved(of, f"was not found: {found.reason}")
        moved_um = UM_PER_MM * (found.centre_mm - expected)
        yield Record(f"{key}/found", "event", {"of": of, "moved_um": moved_um})
        yield MoveTo(f"{key}/leave", point(retreat.at_retreat_plane(retreat.withdrawn_from(found.centre_mm, probing))))
        shift_um, allowed_um = float(np.linalg.norm(moved_um)), UM_PER_MM * self.tolerance_mm
        if shift_um > allowed_um:
            raise self._artefact_moved(of, f"is {shift_um:.1f} µm from where it was, allowed {allowed_um:.1f} µm")

    def _artefact_moved(self, of: str, how: str) -> ArtefactMoved:
        return ArtefactMoved(
            f"the ball of {of} {how}",
            hint="artefact, mount or machine have moved since the interruption: this position is measured again",
        )

    def _approach(self, goal: Array) -> Plan[None]:
        """Move to `goal`, first in the retreat plane and then along the stylus.

        Each axis approaches its position from the same side as before the interruption.
        """
        retreat, axes = self.rules.retreat, self.trace.axes
        along = retreat.retreat_axis
        across = [axis for axis in range(3) if axis != along]
        side = retreat.at_retreat_plane(goal)
        for axis in across:
            side[axis] = axes[axis][0].beside_mm if axes[axis] else goal[axis]
        if self.rules.placement is None:
            yield MoveTo(f"{self.prefix}/beside", point(side))
        else:
            yield from self._cross(f"{self.prefix}/beside", side, self.rules.placement)
        for axis in across:
            yield from self._axis(axis, side, axes[axis], goal[axis])
        if axes[along]:
            yield from self._move_in(along, side, goal)

    def _move_in(self, along: int, here: Array, goal: Array) -> Plan[None]:
        """Move along the retreat axis from the retreat plane to `goal`, approaching from the same side as before.

        If `goal` is on the retreat plane, nothing moves, because the next move from there along the retreat axis takes
        up the play anyway.
        """
        moves = self.trace.axes[along]
        inwards = np.sign(goal[along] - here[along])
        if inwards == 0.0:
            return
        if inwards != moves[0].sign:
            here[along] = moves[0].beside_mm
            yield MoveTo(f"{self.prefix}/down", point(here), WITHDRAW_FEED_MM_PER_S)
        yield from self._axis(along, here, moves, goal[along])

    def _axis(self, axis: int, here: Array, moves: list[AxisMove], goal: float) -> Plan[None]:
        """Repeat the last moves of one axis up to `goal`, and update `here`."""
        for number, move in enumerate(moves):
            here[axis] = goal if move is moves[-1] else move.end_mm
            yield Retrace(f"{self.prefix}/{'xyz'[axis]}-{number}", point(here), move.key, WITHDRAW_FEED_MM_PER_S)
        here[axis] = goal
