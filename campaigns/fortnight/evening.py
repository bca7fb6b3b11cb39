"""Record of one evening of the fortnight: the expected runs, the claims, and the true machine errors that only the
simulator knows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ExpectedRun:
    """Row that the run history is expected to contain for a run.

    The decision of the run must be one of those in `decision`, and the reason of the run must contain the text
    `reason`.
    """

    kind: str
    state: str
    by: str
    decision: tuple[str | None, ...] = (None,)
    reason: str = ""
    accepted: bool | None = None


@dataclass
class Evening:
    """Record of one evening of the fortnight.

    `true_before`, `true_after` and `reach` are true volumetric errors in µm that remain after the best-fitting rigid
    motion is removed. `true_before` is the error with the compensation table of the previous day. `true_after` is the
    error with the table that is active at the end of the evening's runs. `reach` is the error after a full calibration
    of the machine as it is in that night; it is 0 if it was not computed. `exit_codes` are the exit codes of the
    commands that systemd's timer called, in order.
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
        """Ratio of `true_after`, the true error at the end, to `reach`, the error after a full calibration; infinite if
        `reach` was not computed.
        """
        return self.true_after / self.reach if self.reach else math.inf

    @property
    def failed(self) -> list[str]:
        return [f"night {self.night + 1}, {self.incident}: {name}" for name, held in self.claims.items() if not held]
