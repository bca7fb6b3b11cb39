"""Static files of the service's web page. They are the HTML document, its assets, and the drawing scripts of the plan
preview. The access check of the HTTP application (`agent.service.http.guard`) also checks the requests for these files.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from importlib.resources import as_file, files
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from agent.language.records import record_words
from agent.language.sentences import catalogue
from agent.results.run_verdict import verdict_words
from agent.service.http.app_state import AppState
from agent.service.page.endpoints import page_router

CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data:",
        "connect-src 'self'",
        "font-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
"""Policy that forbids inline scripts, inline styles and external resources."""


def mount_page(app: FastAPI, _: AppState) -> None:
    """Add the routes `/`, `/assets/…`, `/drawing/…` and `/api/page/…` to the application. Browsers must revalidate the
    files at each request, because the file names contain no version."""
    drawing = _directory("agent.planning.preview")
    scripts = {path.name: path for path in drawing.glob("*.js")}

    mount_document(app, "index.html")

    @app.get("/drawing/{name}", include_in_schema=False)
    def drawing_script(name: str) -> Response:
        path = scripts.get(name)
        return Response(status_code=404) if path is None else FileResponse(path, media_type="text/javascript")

    app.include_router(page_router())


def mount_document(app: FastAPI, name: str) -> None:
    """Add the routes `/`, which answers with the HTML document `name`, and `/assets/…`, with the policy of the page."""
    own = _directory("agent.service.page") / "assets"

    @app.get("/", include_in_schema=False)
    def page() -> FileResponse:
        return FileResponse(own / name, media_type="text/html")

    @app.get("/assets/verdicts.json", include_in_schema=False)
    def verdicts() -> dict[str, dict[str, str]]:
        return verdict_words()

    @app.get("/assets/records.json", include_in_schema=False)
    def records() -> dict[str, dict[str, str]]:
        return record_words()

    @app.get("/assets/german.json", include_in_schema=False)
    def german() -> dict[str, str]:
        return catalogue()

    app.mount("/assets", StaticFiles(directory=own))
    app.middleware("http")(_with_policy)


async def _with_policy(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
    """Add the content security policy to every response except those of `/api/`, since reports have inline styles."""
    response = await call_next(request)
    if not request.url.path.startswith("/api/"):
        response.headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY
        response.headers["Cache-Control"] = "no-cache"
    return response


def _directory(package: str) -> Path:
    """Return the directory with the data files of a package, which is always installed as a directory."""
    with as_file(files(package)) as path:
        return path
