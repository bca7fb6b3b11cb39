"""Route `/metrics` for Prometheus. The metrics are made from the run history and the current status of the service.
Requests for them pass the access check of the HTTP application (`agent.service.http.guard`), but no token is required.
"""

from __future__ import annotations

from contextlib import closing
from threading import Lock
from typing import TYPE_CHECKING

from fastapi import FastAPI
from fastapi.responses import Response

from agent.execution.journal_reader import has_journal
from agent.service.allowed_requests import AT_REST
from agent.service.control import Status
from agent.service.http.app_state import AppState
from agent.settings.schema import Settings

if TYPE_CHECKING:
    from agent.history.schema import StoredRun
    from agent.history.store import HistoryStore
    from agent.history.trends import Trend

PATH = "/metrics"


def mount_metrics(app: FastAPI, app_state: AppState) -> None:
    """Add the route `/metrics` to the application. This function has the type `agent.service.http.app.Extension`. The
    client of the history database is imported only at the first request."""
    cache = _MetricsCache()

    @app.get(PATH, include_in_schema=False)
    def metrics() -> Response:
        from agent.history.metrics import CONTENT_TYPE  # noqa: PLC0415

        return Response(cache.text(app_state.settings(), app_state.control.status()), media_type=CONTENT_TYPE)


class _MetricsCache:
    """Cache of the runs and their trends. The trends are fitted again only if runs or history settings have changed."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._key: object = None
        self._runs: list[StoredRun] = []
        self._trends: tuple[Trend, ...] = ()

    def text(self, settings: Settings, status: Status) -> str:
        """Return the metrics as text. Raise LinkLost or ConfigurationError if the history cannot be read."""
        from agent.history.database_url import database_address  # noqa: PLC0415
        from agent.history.metrics import metrics_text  # noqa: PLC0415
        from agent.history.store import HistoryStore  # noqa: PLC0415

        with self._lock, closing(HistoryStore(database_address(settings))) as store:
            self._refresh(settings, store)
            return metrics_text(store.address.machine, self._runs, self._trends, live_gauges(status))

    def _refresh(self, settings: Settings, store: HistoryStore) -> None:
        from agent.execution.run_record import run_ids  # noqa: PLC0415
        from agent.history.overview import trends_of  # noqa: PLC0415
        from agent.history.sync import sync  # noqa: PLC0415

        machine = store.address.machine
        digests = dict(store.digests(machine))
        directory = settings.state_directory
        if has_journal(directory) and not set(run_ids(directory)) <= set(digests):
            sync(directory, store)
            digests = dict(store.digests(machine))
        key = (settings.history.model_dump_json(), tuple(sorted(digests.items())))
        if key != self._key:
            self._runs = list(store.runs(machine))
            self._trends = trends_of(self._runs, settings.history)
            self._key = key


def live_gauges(status: Status) -> dict[str, float]:
    """Return the Prometheus gauges that show the current status of the service, by name."""
    return {
        "run_under_way": float(status.state not in AT_REST),
        "run_fraction": status.fraction,
        "run_unfinished": float(status.unfinished is not None),
        "alarms_open": float(len(status.alarms)),
    }
