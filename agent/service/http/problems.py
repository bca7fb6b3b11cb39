"""Problem documents (RFC 9457), which report errors with cause, location and remedy. They never contain a traceback."""

from __future__ import annotations

from collections.abc import Callable
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from agent import errors as run_errors
from agent.service.alarms import alarm_code
from agent.service.state.archive import UnknownRun
from drivers import errors

log = structlog.get_logger()

MEDIA_TYPE = "application/problem+json"
PROBLEM_SCHEMA = {"$ref": "#/components/schemas/Problem"}

STATUS: dict[type[errors.VolcalError], HTTPStatus] = {
    errors.VolcalError: HTTPStatus.INTERNAL_SERVER_ERROR,
    UnknownRun: HTTPStatus.NOT_FOUND,
    errors.UserError: HTTPStatus.UNPROCESSABLE_ENTITY,
    errors.DeviceError: HTTPStatus.SERVICE_UNAVAILABLE,
    errors.PermissionMissing: HTTPStatus.CONFLICT,
    run_errors.RunError: HTTPStatus.CONFLICT,
    run_errors.JournalFailed: HTTPStatus.SERVICE_UNAVAILABLE,
}


class Problem(BaseModel):
    """Problem document, which reports one error.

    `title` is the error class. `code` is the alarm number. `where` maps the kind of each known location (device, step,
    file, key and others) to its name.
    """

    title: str
    status: int
    detail: str
    hint: str = ""
    where: dict[str, str] = {}
    code: int | None = None


class RequestRefused(Exception):
    """Error raised if the HTTP endpoint itself refuses a request, before the request reaches the `Control` of the
    service."""

    def __init__(
        self,
        status: HTTPStatus,
        detail: str,
        hint: str = "",
        headers: dict[str, str] | None = None,
        title: str | None = None,
    ) -> None:
        super().__init__(detail)
        self.problem = Problem(title=title or status.phrase, status=status, detail=detail, hint=hint)
        self.headers = headers


def problem_of(error: errors.VolcalError) -> Problem:
    status = next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)
    code = alarm_code(error).code
    return Problem(
        title=type(error).__name__,
        status=status,
        detail=error.message,
        hint=error.hint,
        where=error.where,
        code=code,
    )


def answer(problem: Problem, headers: dict[str, str] | None = None) -> JSONResponse:
    return JSONResponse(problem.model_dump(), problem.status, headers, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Install in the HTTP application the handlers that turn every error of a request into a problem document. The
    OpenAPI document then states the media type of these documents."""
    # FastAPI's own way to extend its document
    app.openapi = _with_media_type(app.openapi)  # type: ignore[method-assign]

    @app.exception_handler(errors.VolcalError)
    def volcal_error(_: Request, error: errors.VolcalError) -> JSONResponse:
        return answer(problem_of(error))

    @app.exception_handler(RequestRefused)
    def refused_request(_: Request, error: RequestRefused) -> JSONResponse:
        return answer(error.problem, error.headers)

    @app.exception_handler(RequestValidationError)
    def invalid_request(_: Request, error: RequestValidationError) -> JSONResponse:
        return answer(_first_of(error))

    @app.exception_handler(HTTPException)
    def framework_error(_: Request, error: HTTPException) -> JSONResponse:
        status = HTTPStatus(error.status_code)
        return answer(Problem(title=status.phrase, status=status, detail=str(error.detail)), dict(error.headers or {}))

    @app.exception_handler(Exception)
    def defect(_: Request, error: Exception) -> JSONResponse:
        log.error("defect in the service", exc_info=error)
        status = HTTPStatus.INTERNAL_SERVER_ERROR
        detail = f"defect in the service: {type(error).__name__}"
        problem = Problem(title=status.phrase, status=status, detail=detail, hint="please report it")
        return answer(problem, {"Connection": "close"})


def _with_media_type(describe: Callable[[], dict[str, Any]]) -> Callable[[], dict[str, Any]]:
    """Return a function with the OpenAPI document of `describe`, in which problem documents have their media type.
    FastAPI gives all responses of a route the same one."""

    def described() -> dict[str, Any]:
        document = describe()
        for path in document["paths"].values():
            for operation in path.values():
                for status in map(str, DOCUMENTED):
                    operation["responses"][status]["content"] = {MEDIA_TYPE: {"schema": PROBLEM_SCHEMA}}
        return document

    return described


def _first_of(error: RequestValidationError) -> Problem:
    first: dict[str, Any] = dict(error.errors()[0])
    key = ".".join(str(part) for part in first["loc"] if part != "body")
    malformed = first["type"] == "json_invalid"
    status = HTTPStatus.BAD_REQUEST if malformed else HTTPStatus.UNPROCESSABLE_ENTITY
    detail = f"the body is not JSON: {first['ctx']['error']}" if malformed else str(first["msg"])
    return Problem(
        title=status.phrase,
        status=status,
        detail=detail,
        where={} if malformed else {"key": key},
        hint="see /api/openapi.json for what is expected",
    )


DOCUMENTED: dict[int | str, dict[str, Any]] = {
    "4XX": {"model": Problem, "description": "Problem document: cause, location and remedy"},
    503: {"model": Problem, "description": "Problem document: a device or the journal fails, or too many requests"},
}
"""Value of the argument `responses` of the routes, which documents their problem documents."""
