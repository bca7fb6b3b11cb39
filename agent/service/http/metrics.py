"""Route `/metrics` for Prometheus. The metrics are made from the run history and the current status of the service.
Requests for them pass the access check of the HTTP application (`agent.service.http.guard`), but no token is required.

If the history cannot be read, its metrics are left out. Those of the service are told all the same: the database may be
on a server that is switched off, and an open alarm must reach the monitoring meanwhile.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import structlog
from fastapi import FastAPI
from fastapi.responses import Response

from agent.service.allowed_requests import AT_REST
from agent.service.control import Status
from agent.service.http.app_state import AppState
from agent.settings.schema import Settings
from drivers.errors import VolcalError

if TYPE_CHECKING:
    from agent.history.metrics import CachedMetrics

log = structlog.get_logger()
PATH = "/metrics"


def mount_metrics(app: FastAPI, app_state: AppState) -> None:
    """Add the route `/metrics` to the application. This function has the type `agent.service.http.app.Extension`. The
    client of the history database is imported only at the first request."""
    of_history = HistoryMetrics()

    @app.get(PATH, include_in_schema=False)
    def metrics() -> Response:
        from agent.history.metrics import CONTENT_TYPE, live_text  # noqa: PLC0415
        from agent.history.run_row import machine_name  # noqa: PLC0415

        settings = app_state.settings()
        text = of_history.text(settings)
        gauges = live_gauges(app_state.control.status(), history_readable=text is not None)
        live = live_text(machine_name(settings.model_dump(mode="json")), gauges)
        return Response((text or "") + live, media_type=CONTENT_TYPE)


class HistoryMetrics:
    """Metrics made from the history. That it cannot be read is logged once for each disturbance."""

    def __init__(self) -> None:
        self._cached = cache(_cached_metrics)
        self._readable = True

    def text(self, settings: Settings) -> str | None:
        """Return the metrics in the text format of Prometheus, None if the history cannot be read."""
        try:
            _, text = self._cached().text(settings)
        except VolcalError as error:
            if self._readable:
                log.warning("metrics without the history", reason=str(error))
            self._readable = False
            return None
        self._readable = True
        return text


def _cached_metrics() -> CachedMetrics:
    from agent.history.cached_trends import shared_trends  # noqa: PLC0415
    from agent.history.metrics import CachedMetrics  # noqa: PLC0415

    return CachedMetrics(shared_trends())


def live_gauges(status: Status, *, history_readable: bool) -> dict[str, float]:
    """Return the Prometheus gauges that show the current status of the service, by name."""
    return {
        "history_readable": float(history_readable),
        "run_under_way": float(status.state not in AT_REST),
        "run_fraction": status.fraction,
        "run_unfinished": float(status.unfinished is not None),
        "alarms_open": float(len(status.alarms)),
        "notices_waiting": float(sum(one.waiting for one in status.receivers)),
        "receivers_failing": float(sum(one.delivery == "fails" for one in status.receivers)),
        "receivers_partial": float(sum(one.delivery == "partial" for one in status.receivers)),
    }
