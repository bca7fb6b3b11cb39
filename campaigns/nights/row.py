"""Row of results for one night of a season."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NightRow:
    """Results of one night; errors in µm.

    Four fields are true errors: `true_before` with the table of the previous night, `true_after` with the table active
    in the morning, `untouched` with the table of the first night, and `reach` after a full calibration in that night.
    `ve_now` and `ve_after` are the errors reported by the agent.
    """

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
