"""HTTP application. It consists of routers, whose requests all pass an access check (`agent.service.http.guard`). The
web page and the metrics are added as extensions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib.metadata import version

from fastapi import Depends, FastAPI

from agent.service.http import commands, diagnostics, events, history, pairing, problems, queries
from agent.service.http.app_state import AppState
from agent.service.http.guard import Guard
from agent.service.http.permission import of_this_machine

Extension = Callable[[FastAPI, AppState], None]
"""Function that adds routers or mounts static files behind the same guard."""


def create_app(app_state: AppState, names: Collection[str] = (), extensions: Sequence[Extension] = ()) -> FastAPI:
    """Return the HTTP application. `names` are the host names by which clients may address the application in addition
    to the loopback names."""
    app = FastAPI(
        title="volcal",
        version=version("volcal"),
        summary="Calibration service of one machine.",
        openapi_url="/api/openapi.json",
        docs_url=None,
        redoc_url=None,
    )
    app.state.app_state = app_state
    app.add_middleware(Guard, names=names)
    problems.install(app)
    add_endpoints(app)
    for extend in extensions:
        extend(app, app_state)
    return app


def add_endpoints(app: FastAPI) -> None:
    app.include_router(commands.stopping)
    routers = (queries.router, history.router, events.router, commands.with_token, diagnostics.router)
    for router in (*routers, pairing.without_token, pairing.with_token, pairing.of_machine):
        app.include_router(router, dependencies=[Depends(of_this_machine)])
