"""Record of an evening: expected runs, claims, and the true errors known only to the simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ExpectedRun:
    """Expected history row of a run. Its decision must be one of `decision`, and its reason must contain `reason`."""

    kind: str
    state: str
    by: str
    decision: tuple[str | None, ...] = (None,)
    reason: str = ""
    accepted: bool | None = None


@dataclass
class Evening:
    """Record of one evening.

    The true volumetric errors are in µm, after the best-fitting rigid motion is removed. `true_before` is the error
    with the table of the previous day, `true_after` the error with the table active at the end, and `reach` the error
    after a full calibration of that night's machine (0 if not computed). `exit_codes` are the exit codes of the
    commands called by the timer, in order.
    """

    night: int
    incident: str
    station: int
    true_before: float = 0.0
    true_after: float = 0.0
    reach: float = 0.0
    active_bank: int = 0
    exit_codes: list[int] = field(default_factory=list)
    expected: list[ExpectedRun] = field(default_factory=list)
    claims: dict[str, bool] = field(default_factory=dict)
    figures: dict[str, object] = field(default_factory=dict)
    wall_s: float = 0.0

    @property
    def ratio(self) -> float:
        """`true_after` divided by `reach`; infinite if `reach` was not computed."""
        return self.true_after / self.reach if self.reach else math.inf

    @property
    def failed(self) -> list[str]:
        return [f"night {self.night + 1}, {self.incident}: {name}" for name, held in self.claims.items() if not held]
