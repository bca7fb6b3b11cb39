"""Overview of all machines that share one history database: the last run of each, its accuracy and its drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from itertools import groupby
from operator import attrgetter
from typing import Any

import numpy as np

from agent.history.dated_ahead import ahead_text, by_date
from agent.history.recent_runs import RecentRun
from agent.history.schema import utc_text, utc_time
from agent.history.series import BARE, CHANGED_MACHINE, TITLES, Series
from agent.history.trends import Trend, trend_of
from agent.results.active_table import active_table_figures
from agent.results.run_verdict import RUNNING, Look, RunVerdict
from twin.units import S_PER_DAY

RECENT_RUNS = 30
"""Number of latest runs of a machine from which its drift is estimated."""
_URGENCY = (Look.BAD, Look.REFUSED, Look.WAITING, Look.BUSY, Look.NEUTRAL, Look.GOOD)
_SHORTEST_DAYS = 1.0
_NO_WARNING = 0.0
"""Nights of warning before a tolerance; the plant states none."""


@dataclass(frozen=True, eq=False)
class MachineSummary:
    """Summary of one machine. `last` is its last run, `verdict` the verdict on it, and `days` the time in days since
    its start.

    `ve_um`, `vce_um` and `held_out_um` are the newest known volumetric error (VE) without a table, the one with the
    active table (VCE), and the rms of the held-out balls with it. The last two are None after a stored table was
    restored for which none of the latest runs states them. `recent` are its latest runs, the oldest run first,
    without those dated in the future (`ahead`).
    """

    machine: str
    last: RecentRun
    verdict: RunVerdict
    days: float
    ve_um: float | None
    vce_um: float | None
    held_out_um: float | None
    recent: Sequence[RecentRun]
    ahead: Sequence[RecentRun]

    @property
    def ahead_text(self) -> str:
        """Sentence that names the runs that are dated in the future, an empty text without any."""
        return ahead_text(self.ahead)

    @property
    def started(self) -> datetime:
        """Start of the last run in UTC; a database server may state it in another time zone."""
        return utc_time(self.last.started)

    @cached_property
    def trend(self) -> Trend | None:
        """Trend of the VE without a table over the latest runs; None if none of them states it. It is fitted when it is
        first read, since a page of a list shows only some of the machines."""
        series = _series(self.recent)
        return None if series is None else trend_of(series, _NO_WARNING)

    @property
    def drift_um(self) -> tuple[float, float] | None:
        """Drift of the VE without a table in µm per night and its expanded uncertainty (95 %), or None if there are too
        few values for a line, or if all of them are from less than one day."""
        if self.trend is None or self.trend.drift is None or np.ptp(self.trend.series.nights) < _SHORTEST_DAYS:
            return None
        drift = self.trend.drift
        return drift.slope, drift.factor * drift.slope_sigma

    @property
    def drifts(self) -> bool:
        """Return True if the drift is significant."""
        return self.drift_um is not None and abs(self.drift_um[0]) > self.drift_um[1]

    def as_json(self) -> dict[str, Any]:
        """Return the summary as a mapping to be written as JSON; docs/reference/json.md describes the keys."""
        drift = self.drift_um
        return {
            "machine": self.machine,
            "run_id": self.last.run_id,
            "kind": self.last.kind,
            "started": utc_text(self.last.started),
            "days": round(self.days, 2),
            "verdict": self.verdict.as_json(),
            "ve_um": self.ve_um,
            "vce_um": self.vce_um,
            "held_out_um": self.held_out_um,
            "drift_um_a_night": None if drift is None else drift[0],
            "drift_expanded_uncertainty": None if drift is None else drift[1],
            "significant": self.drifts,
            "dated_ahead": [run.run_id for run in self.ahead],
        }


def plant_summaries(
    runs: Sequence[RecentRun], now: datetime, running: tuple[str, str] | None = None
) -> tuple[MachineSummary, ...]:
    """Return the summaries of all machines, those that need attention first: by the verdict on the last run, then by
    the days since then.

    `runs` are sorted by machine, the oldest run of a machine first. `running` names the machine and the run that is
    known to be in progress, which the database does not say.
    """
    found = [_summary(machine, list(of), now, running) for machine, of in groupby(runs, attrgetter("machine"))]
    return tuple(sorted(found, key=lambda one: (_URGENCY.index(one.verdict.look), -one.days, one.machine)))


def _summary(
    machine: str, found: Sequence[RecentRun], now: datetime, running: tuple[str, str] | None
) -> MachineSummary:
    dated = by_date(found, now)
    runs, last = dated.counted, dated.counted[-1]
    active = active_table_figures(runs)
    in_progress = last.ended is None and (machine, last.run_id) == running
    return MachineSummary(
        machine=machine,
        last=last,
        verdict=RUNNING if in_progress else last.verdict,
        days=max((now - utc_time(last.started)).total_seconds(), 0.0) / S_PER_DAY,
        ve_um=next((run.ve_before_um for run in reversed(runs) if run.ve_before_um is not None), None),
        vce_um=active.vce_um,
        held_out_um=active.held_out_um,
        recent=runs,
        ahead=dated.ahead,
    )


def _series(runs: Sequence[RecentRun]) -> Series | None:
    """Return the series of the VE without a table, by calendar days; None if no run has a value."""
    first = utc_time(runs[0].started)
    days = [(utc_time(run.started) - first).total_seconds() / S_PER_DAY for run in runs]
    found = [(day, run) for day, run in zip(days, runs, strict=True) if run.ve_before_um is not None]
    if not found:
        return None
    sigmas = np.array([run.ve_before_sigma_um for _, run in found], dtype=np.float64)  # None is NaN
    stated = bool((sigmas > 0.0).all())
    return Series(
        name=BARE,
        title=TITLES[BARE],
        unit="µm",
        run_ids=tuple(run.run_id for _, run in found),
        nights=np.array([day for day, _ in found]),
        values=np.array([run.ve_before_um for _, run in found], dtype=np.float64),
        sigmas=sigmas if stated else np.ones(len(found)),
        stated=stated,
        tolerance=None,
        two_sided=False,
        steps=tuple(sorted({day for day, run in zip(days, runs, strict=True) if run.night in CHANGED_MACHINE})),
        started_s=np.array([utc_time(run.started).timestamp() for _, run in found]),
    )
