"""Interface of the check whether the measured balls of one position fit each other. It serves balls that are touched
too few times for a form error of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from agent.probing.measured_balls import MeasuredBall


@dataclass(frozen=True)
class InconsistentBall:
    """Ball that does not fit the other balls of its position. `deviation_um` is the deviation of its touch `touch` from
    the place where the other balls predict the surface, and `limit_um` is the limit of this deviation."""

    ball: int
    touch: int
    deviation_um: float
    limit_um: float

    @property
    def text(self) -> str:
        return (
            f"touch {self.touch} is {self.deviation_um:.1f} µm beside the place that the other balls of the position "
            f"predict, allowed {self.limit_um:.1f} µm"
        )


class BallConsistency(Protocol):
    """Interface of the check of the balls of one position."""

    def inconsistent(self, balls: Sequence[MeasuredBall]) -> tuple[InconsistentBall, ...]:
        """Return those of the measured `balls` of one position that do not fit the others."""
        ...
