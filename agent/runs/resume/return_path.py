"""Path by which the machine returns after an interruption, from any position to the position at which the next step of
the run begins.

The probe is first withdrawn along the stylus. Then the mount is turned back and the ball measured last is measured
again. Finally each axis approaches its position from the same side as before the interruption, so that the play of the
axis is taken up in the same direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.errors import MeasurementFault
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
)
from agent.probing.ball import LostBall, measure_ball, point
from agent.probing.position import PositionRules
from agent.probing.recovery import WITHDRAW_FEED_MM_PER_S, withdraw
from agent.runs.resume.step_trace import AxisMove, StepTrace
from twin.arrays import Array
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class ReturnPath:
    """Path by which the machine returns, after an interruption of a run, to the position at which the next step of the
    run begins.

    `prefix` is the beginning of the key of every step of the path. `tolerance_mm` is the largest permitted
    displacement, in mm, of the ball that is measured again.
    """

    prefix: str
    trace: StepTrace
    rules: PositionRules
    tolerance_mm: float

    def plan(self, following: Step) -> Plan[None]:
        """Move to the position at which `following`, the next step of the run, begins. Raises MeasurementFault if the
        artefact has moved since the interruption."""
        trace, rules = self.trace, self.rules
        if not trace.moved:
            return
        probing = rules.probing
        yield from withdraw(rules.retreat, np.asarray(probing.stylus_axis), probing.retract_mm, trace.last_motion)
        yield CheckProbe(f"{self.prefix}/probe")
        if trace.pose is not None and not isinstance(following, (OrientTo, AskOperator)):
            yield from self._turn_mount_back(trace.pose)
            if trace.datum_mm is not None:
                yield from self._datum(np.array(trace.datum_mm))
        if trace.at_mm is not None:
            yield from self._approach(np.array(trace.at_mm))

    def _turn_mount_back(self, pose: OrientTo) -> Plan[None]:
        """Turn the mount back to `pose`. It may have sunk without power, or its turn may have been interrupted."""
        here = np.array((yield ReadPosition(f"{self.prefix}/here")))
        yield MoveTo(f"{self.prefix}/park", point(self.rules.retreat.park_location(here, pose.station)))
        yield OrientTo(f"{self.prefix}/orient", pose.station, pose.azimuth_deg, pose.elevation_deg)

    def _datum(self, expected: Array) -> Plan[None]:
        """Measure again, as the datum, the last ball whose centre was found in this pose."""
        probing, retreat = self.rules.probing, self.rules.retreat
        key = f"{self.prefix}/datum"
        above = retreat.withdrawn_from(expected, probing)
        yield MoveTo(f"{key}/enter", point(retreat.at_retreat_plane(above)))
        yield MoveTo(f"{key}/approach", point(above))
        found = yield from measure_ball(key, expected, probing, probing.narrow_search)
        if isinstance(found, LostBall):
            raise self._artefact_moved(f"was not found: {found.reason}")
        moved_um = UM_PER_MM * (found.centre_mm - expected)
        yield Record(f"{key}/found", "event", {"of": self.trace.datum_key, "moved_um": moved_um})
        yield MoveTo(f"{key}/leave", point(retreat.at_retreat_plane(retreat.withdrawn_from(found.centre_mm, probing))))
        shift_um, allowed_um = float(np.linalg.norm(moved_um)), UM_PER_MM * self.tolerance_mm
        if shift_um > allowed_um:
            raise self._artefact_moved(f"is {shift_um:.1f} µm from where it was, allowed {allowed_um:.1f} µm")

    def _artefact_moved(self, how: str) -> MeasurementFault:
        return MeasurementFault(
            f"the ball of {self.trace.datum_key} {how}",
            hint="artefact, mount or machine have moved since the interruption: start a new run",
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
        yield MoveTo(f"{self.prefix}/beside", point(side))
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
