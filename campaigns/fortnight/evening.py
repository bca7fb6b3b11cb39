"""What is kept of an evening: what happened, what was claimed of it, and what only the simulator knows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Expected:
    """The row of a run in history: `decision` one of these, `reason` a part of it."""

    kind: str
    state: str
    by: str
    decision: tuple[str | None, ...] = (None,)
    reason: str = ""
    accepted: bool | None = None


@dataclass
class Evening:
    """µm, aligned: `true_before` with the table of the day before, `true_after` as it is left, `reach` of a full
    calibration of that night's machine, 0 where it was not worked out. `asked`: exit codes of what the timer called,
    in turn."""

    night: int
    incident: str
    station: int
    true_before: float = 0.0
    true_after: float = 0.0
    reach: float = 0.0
    active_bank: int = 0
    asked: list[int] = field(default_factory=list)
    expected: list[Expected] = field(default_factory=list)
    claims: dict[str, bool] = field(default_factory=dict)
    told: dict[str, object] = field(default_factory=dict)
    wall_s: float = 0.0

    @property
    def ratio(self) -> float:
        """Infinite where nobody has worked out the reach."""
        return self.true_after / self.reach if self.reach else math.inf

    @property
    def failed(self) -> list[str]:
        return [f"night {self.night + 1}, {self.incident}: {name}" for name, held in self.claims.items() if not held]
