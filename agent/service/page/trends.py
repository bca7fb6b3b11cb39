"""Trends over the nights, for the service's web page. They show either the volumetric errors and the geometric errors,
or the parameters of one geometric error."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from threading import Lock
from typing import Any

from agent.execution.journal_reader import has_journal
from agent.execution.run_record import run_ids
from agent.history.database_url import database_address
from agent.history.overview import VOLUMETRIC, alarms_of
from agent.history.schema import StoredRun
from agent.history.series import Series, all_series
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.history.trends import Trend, trend_of
from agent.settings.schema import Settings

Document = dict[str, Any]


class TrendCache:
    """Cache of the trends. They are computed again only if the runs in the history or the history settings have
    changed. The cache is safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cached: dict[str | None, tuple[object, Document]] = {}

    def document(self, settings: Settings, of: str | None) -> Document:
        """Return the trends of all parameters of the geometric error `of`. If `of` is None, return the trends of the
        volumetric errors and of the geometric errors.

        Raise LinkLost or ConfigurationError if the history cannot be read.
        """
        with closing(HistoryStore(database_address(settings))) as store:
            digests = dict(store.digests(store.address.machine))
            if has_journal(settings.state_directory) and not set(run_ids(settings.state_directory)) <= set(digests):
                sync(settings.state_directory, store)
                digests = dict(store.digests(store.address.machine))
            key = (settings.history.model_dump_json(), tuple(sorted(digests.items())))
            with self._lock:
                if of not in self._cached or self._cached[of][0] != key:
                    self._cached[of] = (key, _document(store.runs(store.address.machine), settings, of))
                return self._cached[of][1]


def _document(runs: Sequence[StoredRun], settings: Settings, of: str | None) -> Document:
    chosen = [series for series in all_series(runs, settings.history) if _is_selected(series, of)]
    trends = [trend_of(series, settings.history.warn_nights) for series in chosen]
    return {
        "trends": [_trend(trend) for trend in trends],
        "alarms": [{"series": a.series, "kind": a.kind.value, "text": a.text} for a in alarms_of(trends)],
        "runs": {run.run_id: {"started": _utc(run), "kind": run.kind, "state": run.state} for run in runs},
    }


def _is_selected(series: Series, of: str | None) -> bool:
    """Return True if the series is to be shown for `of`. Names of parameters contain a bracket; names of
    errors do not.
    """
    if of is None:
        return series.name in VOLUMETRIC or "[" not in series.name
    return series.name.startswith(f"{of}[")


def _trend(trend: Trend) -> Document:
    """Return the trend with the values of the fitted line and the half width of its band."""
    drift = trend.drift
    half = (
        []
        if drift is None
        else [drift.factor * drift.predict(night - trend.series.nights[-1])[1] for night in trend.series.nights]
    )
    return {
        **trend.as_json(),
        "volumetric": trend.series.name in VOLUMETRIC,
        "two_sided": trend.series.two_sided,
        "fitted": None if drift is None else drift.fitted.tolist(),
        "fitted_half_width": None if drift is None else half,
    }


def _utc(run: StoredRun) -> str:
    """Return the start of the run as text with the zone UTC, which SQLite does not store."""
    return run.started.replace(tzinfo=None).isoformat() + "Z"
