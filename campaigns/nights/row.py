"""One night of a season, as a row of the result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One night. µm: `true_before` with the table of the night before, `true_after` with the one that acts in the
    morning, `untouched` with that of the first night, `reach` of a full calibration that night; `ve_now` and `ve_after`
    as the agent says."""

    night: int
    station: int
    decision: str
    minutes: float
    positions: int
    true_before: float
    true_after: float
    untouched: float
    reach: float
    ratio: float
    ve_now: float | None
    ve_after: float | None
    chi2: float | None
    named: str
    reason: str
