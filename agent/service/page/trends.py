"""Trends over the nights, for the service's web page. They show either the volumetric errors and the geometric errors,
or the parameters of one geometric error."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Lock
from typing import Any

from agent.execution.states import RunState
from agent.history.cached_trends import CachedTrends, MachineTrends
from agent.history.helpful_actions import HelpfulAction, alarms_json, helpful_actions, sources_key
from agent.history.kept_documents import KeptDocuments
from agent.history.overview import VOLUMETRIC, alarms_of
from agent.history.schema import StoredRun
from agent.history.series import CHANGED_MACHINE, Series, nights_of
from agent.history.trends import Trend
from agent.settings.schema import Settings

Document = dict[str, Any]


FILE_NAME = "trends.json"
"""File of the state directory with the documents of the trends."""
_OVERVIEW = ""
"""Key of the document of all errors; no error has this name."""


class TrendCache:
    """Cache of the documents of the trends, also over a restart. A document is made again only if runs in the history,
    the settings of the history, or the files from which actions are proposed have changed, or if the date of a run has
    come that was in the future. The trends are taken from `trends`. The cache is safe to use from any thread."""

    def __init__(self, trends: CachedTrends) -> None:
        self._trends = trends
        self._lock = Lock()
        self._key: object = None
        self._documents: dict[str, Document] = {}

    def document(self, settings: Settings, of: str | None) -> Document:
        """Return the trends of all parameters of the geometric error `of`. If `of` is None or empty, return the trends
        of the volumetric errors and of the geometric errors. A name of which the history has no parameters gives a
        document without trends, which is not kept.

        Raise LinkLost or ConfigurationError if the history cannot be read.
        """
        name, kept = of or _OVERVIEW, KeptDocuments(settings.state_directory / FILE_NAME)
        with self._lock:
            sources = sources_key(settings.state_directory, settings.machine)
            key = (self._trends.key(settings), sources)
            if key != self._key:
                self._key, self._documents = key, kept.read(key, dict)
            if name not in self._documents:
                current = self._trends.current(settings)
                if (current.key, sources) != self._key:  # another run has been stored in between
                    self._key, self._documents = (current.key, sources), {}
                document = _document(current, name, settings)
                if name != _OVERVIEW and not document["trends"]:
                    return document  # anything can be asked for
                self._documents[name] = document
                kept.write(self._key, self._documents)
            return self._documents[name]


def _document(current: MachineTrends, name: str, settings: Settings) -> Document:
    trends = [trend for trend in current.trends if _is_selected(trend.series, name)]
    counted, ahead = current.by_date.counted, current.by_date.ahead
    actions = helpful_actions(trends, counted, settings.state_directory, settings.machine)
    return {
        "trends": [_trend(trend, actions.get(trend.series.name)) for trend in trends],
        "alarms": alarms_json(alarms_of(trends, ahead), actions),
        "marks": _marks(counted),
        "runs": {run.run_id: {"started": _utc(run), "kind": run.kind, "state": run.state} for run in current.runs},
    }


def _marks(runs: Sequence[StoredRun]) -> list[Document]:
    """Return the runs that changed the compensation or found the machine changed, with their nights."""
    found = zip(nights_of(runs).tolist(), runs, (_mark(run) for run in runs), strict=True)
    return [{"night": night, "kind": kind, "started": _utc(run)} for night, run, kind in found if kind is not None]


def _mark(run: StoredRun) -> str | None:
    if run.night in CHANGED_MACHINE:
        return "machine"
    if run.accepted is not None:
        return "accepted" if run.accepted else "rejected"
    if run.state == RunState.WRITTEN.value:
        return "written"
    return "restored" if run.kind == "restore" and run.state == RunState.COMPLETE.value else None


def _is_selected(series: Series, name: str) -> bool:
    """Return True if the document `name` shows the series. Names of parameters contain a bracket; names of errors do
    not."""
    if name == _OVERVIEW:
        return series.name in VOLUMETRIC or "[" not in series.name
    return series.name.startswith(f"{name}[")


def _trend(trend: Trend, action: HelpfulAction | None) -> Document:
    """Return the trend with the values of the fitted line, the half width of its band, and what helps most against
    it."""
    drift = trend.drift
    nights = trend.series.nights
    half = None if drift is None else (drift.factor * drift.line_sigma(nights - nights[-1])).tolist()
    return {
        **trend.as_json(),
        "action": None if action is None else action.as_json(),
        "volumetric": trend.series.name in VOLUMETRIC,
        "two_sided": trend.series.two_sided,
        "fitted": None if drift is None else drift.fitted.tolist(),
        "fitted_half_width": half,
    }


def _utc(run: StoredRun) -> str:
    """Return the start of the run as text with the zone UTC, which SQLite does not store."""
    return run.started.replace(tzinfo=None).isoformat() + "Z"
