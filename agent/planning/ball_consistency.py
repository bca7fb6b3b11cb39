"""Check of the balls of one position against each other, with the errors that machine and artefact may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agent.planning.planning_options import planning_options
from agent.probing.ball_consistency import InconsistentBall
from agent.probing.measured_balls import MeasuredBall, no_correction, numbered_together, observations_of
from agent.probing.probing_parameters import ProbingParameters
from agent.settings.schema import Settings
from twin.collision.measuring_layout import MeasuringLayout
from twin.identification.checks.touch_consistency import TouchConsistency
from twin.machine.machine_description import MachineDescription
from twin.units import UM_PER_MM


@dataclass(frozen=True, eq=False)
class PositionConsistency:
    """Check of the balls of one position. `touches` predicts each touch from the others, and `layout` numbers the balls
    of artefacts that stand at their own stations."""

    touches: TouchConsistency
    layout: MeasuringLayout

    def inconsistent(self, balls: Sequence[MeasuredBall]) -> tuple[InconsistentBall, ...]:
        """Return those of the measured `balls` of one position that do not fit the others, the worst one first.

        The balls are compared as displayed, with the active table: its corrections vary as smoothly as the errors.
        """
        seen = observations_of(numbered_together(balls, self.layout), self.layout.tool_offset_mm, no_correction)
        return tuple(
            InconsistentBall(balls[one.ball].ball, one.touch, one.deviation_mm * UM_PER_MM, one.limit_mm * UM_PER_MM)
            for one in self.touches.inconsistent(seen)
        )


def ball_consistency(
    settings: Settings, machine: MachineDescription, layout: MeasuringLayout, probing: ProbingParameters
) -> PositionConsistency | None:
    """Return the check of the balls of a position, or None if the touches of each ball determine its form error."""
    if probing.determines_radius:
        return None
    options = planning_options(settings.temperature)
    false_alarm = settings.procedure.position_false_alarm
    return PositionConsistency(
        TouchConsistency(machine.family, layout.artefact, options, probing.directions, false_alarm), layout
    )
