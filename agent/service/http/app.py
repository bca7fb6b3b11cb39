"""The application: routers behind the guard. What else is served (page, metrics) is an extension."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib.metadata import version

from fastapi import FastAPI

from agent.service.http import commands, diagnostics, events, problems, queries
from agent.service.http.app_state import Site
from agent.service.http.guard import Guard

Extension = Callable[[FastAPI, Site], None]
"""Adds routers or mounts static files; it is behind the same guard."""


def create_app(site: Site, names: Collection[str] = (), extensions: Sequence[Extension] = ()) -> FastAPI:
    """`names`: host names besides loopback's that requests may be addressed to."""
    app = FastAPI(
        title="volcal",
        version=version("volcal"),
        summary="The night service of one machine.",
        openapi_url="/api/openapi.json",
        docs_url=None,
        redoc_url=None,
    )
    app.state.site = site
    app.add_middleware(Guard, names=names)
    problems.install(app)
    add_endpoints(app)
    for extend in extensions:
        extend(app, site)
    return app


def add_endpoints(app: FastAPI) -> None:
    for router in (queries.router, events.router, commands.open_to_all, commands.with_token, diagnostics.router):
        app.include_router(router)
