"""The application: routers behind the guard. What else is served (page, metrics) is an extension."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from importlib.metadata import version

from fastapi import FastAPI

from agent.service.http import asking, diagnostics, events, problems, reading
from agent.service.http.guard import Guard
from agent.service.http.site import Site

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
    for router in (reading.router, events.router, asking.open_to_all, asking.with_token, diagnostics.router):
        app.include_router(router)
