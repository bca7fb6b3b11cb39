"""Route `/metrics` for Prometheus. The metrics are made from the run history and the current status of the service.
Requests for them pass the access check of the HTTP application (`agent.service.http.guard`), but no token is required.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from fastapi import FastAPI
from fastapi.responses import Response

from agent.service.allowed_requests import AT_REST
from agent.service.control import Status
from agent.service.http.app_state import AppState

if TYPE_CHECKING:
    from agent.history.metrics import CachedMetrics

PATH = "/metrics"


def mount_metrics(app: FastAPI, app_state: AppState) -> None:
    """Add the route `/metrics` to the application. This function has the type `agent.service.http.app.Extension`. The
    client of the history database is imported only at the first request."""
    cached_metrics = cache(_cached_metrics)

    @app.get(PATH, include_in_schema=False)
    def metrics() -> Response:
        from agent.history.metrics import CONTENT_TYPE, live_text  # noqa: PLC0415

        machine, text = cached_metrics().text(app_state.settings())
        live = live_text(machine, live_gauges(app_state.control.status()))
        return Response(text + live, media_type=CONTENT_TYPE)


def _cached_metrics() -> CachedMetrics:
    from agent.history.cached_trends import shared_trends  # noqa: PLC0415
    from agent.history.metrics import CachedMetrics  # noqa: PLC0415

    return CachedMetrics(shared_trends())


def live_gauges(status: Status) -> dict[str, float]:
    """Return the Prometheus gauges that show the current status of the service, by name."""
    return {
        "run_under_way": float(status.state not in AT_REST),
        "run_fraction": status.fraction,
        "run_unfinished": float(status.unfinished is not None),
        "alarms_open": float(len(status.alarms)),
        "notices_waiting": float(sum(one.waiting for one in status.receivers)),
        "receivers_failing": float(sum(one.delivery == "fails" for one in status.receivers)),
        "receivers_partial": float(sum(one.delivery == "partial" for one in status.receivers)),
    }
