"""Row of results for one night of a season of nightly runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NightRow:
    """Results of one night; all errors are in µm.

    `true_before`, `true_after`, `untouched` and `reach` are true errors after the best-fitting rigid motion is removed.
    `true_before` is the error with the compensation table of the previous night. `true_after` is the error with the
    table that is active in the morning. `untouched` is the error with the table of the first night. `reach` is the
    error that a full calibration in that night would leave. `ratio` is `true_after` divided by `reach`.

    `ve_now` and `ve_after` are volumetric errors that the agent reports from its measurements. `ve_now` is the error
    with the active table, and `ve_after` is the error with a table made from the estimate of this night.
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
