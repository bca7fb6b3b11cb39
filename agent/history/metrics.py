"""Metrics of one machine in the text format of the monitoring system Prometheus, computed from the history of runs and
the current status.
"""

from __future__ import annotations

from collections import Counter as Tally
from collections.abc import Mapping, Sequence
from threading import Lock

from prometheus_client import CollectorRegistry, Gauge, generate_latest

from agent.execution.states import FINAL
from agent.history.cached_trends import CachedTrends
from agent.history.database_url import database_address
from agent.history.dated_ahead import RunsByDate
from agent.history.kept_documents import KeptDocuments
from agent.history.overview import VOLUMETRIC, alarms_of
from agent.history.schema import StoredRun, utc_time
from agent.history.series import ACTIVE, HELD_OUT
from agent.history.trends import AlarmKind, Trend
from agent.results.active_table import active_table_figures
from agent.results.run_verdict import RESTORED, VERDICTS, Look
from agent.settings.schema import Settings

FILE_NAME = "metrics.json"
"""File of the state directory with the metrics of the history."""
_TEXT = "text"
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def metrics_text(
    machine: str, runs: RunsByDate[StoredRun], trends: Sequence[Trend], live: Mapping[str, float] | None = None
) -> str:
    """Return all metrics of `machine` in the text format of Prometheus. `runs` contains all runs of the machine.

    `live` contains the values of further metrics of the service by name. The metric `link_errors`, for example, is
    written as `volcal_link_errors`. Metrics of the service process itself, such as its memory, are not included.
    """
    registry = CollectorRegistry()
    _of_runs(registry, machine, runs)
    _of_trends(registry, machine, trends, runs)
    return generate_latest(registry).decode() + live_text(machine, live or {})


def live_text(machine: str, live: Mapping[str, float]) -> str:
    """Return the metrics of the service itself."""
    registry = CollectorRegistry()
    for name, value in live.items():
        _gauge(registry, name, f"{name.replace('_', ' ')} of the service").labels(machine).set(value)
    return generate_latest(registry).decode()


class CachedMetrics:
    """Metrics made from the history, which are made again only if it has changed, also over a restart of the service.
    The trends are taken from `trends`. The cache is safe to use from any thread."""

    def __init__(self, trends: CachedTrends) -> None:
        self._trends = trends
        self._lock = Lock()
        self._key: object = None
        self._text: str | None = None

    def text(self, settings: Settings) -> tuple[str, str]:
        """Return the name of the machine and its metrics without those of the service. Raise LinkLost or
        ConfigurationError if the history cannot be read."""
        kept = KeptDocuments(settings.state_directory / FILE_NAME)
        with self._lock:
            key = self._trends.key(settings)
            if key != self._key:
                self._key, self._text = key, kept.read(key, str).get(_TEXT)
            if self._text is None:
                found = self._trends.current(settings)
                self._key, self._text = found.key, metrics_text(found.machine, found.by_date, found.trends)
                kept.write(found.key, {_TEXT: self._text})
            return database_address(settings).machine, self._text


def _of_runs(registry: CollectorRegistry, machine: str, runs: RunsByDate[StoredRun]) -> None:
    states = _gauge(registry, "runs", "runs in history by kind and final state", "kind", "state")
    for (kind, state), count in sorted(Tally((run.kind, run.state) for run in runs.every).items()):
        states.labels(machine, kind, state).set(count)
    ended = [run for run in runs.counted if run.ended is not None]
    good = [run for run in ended if _is_success(run)]
    moments = (("last_run", ended), ("last_success", good))
    for name, chosen in moments:
        if chosen and chosen[-1].ended is not None:
            text = f"end of the {name.replace('_', ' ')}, seconds since 1970"
            _gauge(registry, f"{name}_timestamp_seconds", text).labels(machine).set(
                utc_time(chosen[-1].ended).timestamp()
            )
    if not ended:
        return
    last = ended[-1]
    current = _gauge(registry, "last_run_state", "1 for the state in which the last run ended", "state")
    for state in sorted(state.value for state in FINAL):
        current.labels(machine, state).set(float(last.state == state))
    given = _gauge(registry, "last_run_verdict", "1 for the verdict on the last run", "verdict")
    for verdict in VERDICTS:
        given.labels(machine, verdict.name).set(float(last.verdict is verdict))
    for name, text, value in (
        ("last_run_minutes", "machine time of the last run", last.machine_minutes),
        ("last_run_touches", "touches of the last run", float(last.touches)),
        ("last_run_balls", "ball centres of the last run", float(last.balls)),
    ):
        _gauge(registry, name, text).labels(machine).set(value)


def _is_success(run: StoredRun) -> bool:
    """Return True if the run has measured the machine and its verdict is good. A run is complete as well if its table
    has failed the proof, if the machine is out of its limits, or if it has only restored a table."""
    return run.verdict.look is Look.GOOD and run.verdict is not RESTORED


def _of_trends(registry: CollectorRegistry, machine: str, trends: Sequence[Trend], runs: RunsByDate[StoredRun]) -> None:
    value = _gauge(registry, "trend_value", "newest value of a series", "series", "unit")
    drift = _gauge(registry, "trend_drift_per_night", "drift of a series per night", "series", "unit")
    doubt = _gauge(registry, "trend_drift_uncertainty", "standard uncertainty of the drift", "series", "unit")
    left = _gauge(registry, "trend_nights_left", "expected nights until the tolerance is reached", "series")
    for trend in trends:
        series = trend.series
        labels = (machine, series.name, series.unit)
        value.labels(*labels).set(float(series.values[-1]))
        if trend.drift is not None:
            drift.labels(*labels).set(trend.drift.slope)
            doubt.labels(*labels).set(trend.drift.slope_sigma)
        if trend.crossing is not None:
            left.labels(machine, series.name).set(trend.crossing.expected)
    volumetric = _gauge(registry, "last_ve_micrometres", "newest volumetric error", "which")
    active = active_table_figures(runs.counted)  # the newest value of the trend may be that of a replaced table
    of_active = {ACTIVE: active.vce_um, HELD_OUT: active.held_out_um}
    for trend in trends:
        name = trend.series.name
        newest = of_active[name] if name in of_active else float(trend.series.values[-1])
        if name in VOLUMETRIC and newest is not None:
            volumetric.labels(machine, name).set(newest)
    alarms = _gauge(registry, "trend_alarms", "open alarms of trends and of dates in the future", "kind")
    kinds = Tally(alarm.kind for alarm in alarms_of(trends, runs.ahead))
    for kind in AlarmKind:
        alarms.labels(machine, kind.value).set(kinds[kind])


def _gauge(registry: CollectorRegistry, name: str, text: str, *labels: str) -> Gauge:
    return Gauge(f"volcal_{name}", text, ("machine", *labels), registry=registry)
