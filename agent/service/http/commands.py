"""Command endpoints. Each requires a token whose role permits the request, except abort, which anyone may call."""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from agent.files import translated
from agent.printable import MAX_REASON, one_line
from agent.service.access.roles import CHECK_SETTINGS, RESTORE_TABLE, Requester
from agent.service.allowed_requests import ANSWER, GIVE_UP, HOLD, RESET, RESTORE_FORMER, RESUME, RESUME_RUN, START
from agent.service.http.app_state import AppStateDependency
from agent.service.http.models import (
    AbortBody,
    AnswerBody,
    RequestAccepted,
    RestoreBody,
    ResumeRunBody,
    RunStarted,
    SettingsBody,
    StartBody,
)
from agent.service.http.permission import known_name, permitted
from agent.service.http.problems import DOCUMENTED
from agent.settings.schema import parse_settings
from drivers.errors import ConfigurationError

stopping = APIRouter(prefix="/api", tags=["asking"], responses=DOCUMENTED)
"""Requests that stop the machine. They are carried out even if the client means another machine."""
with_token = APIRouter(prefix="/api", tags=["asking"], responses=DOCUMENTED)


_ABORT_BODY = {"requestBody": {"content": {"application/json": {"schema": AbortBody.model_json_schema()}}}}


# FastAPI refuses a request whose body it cannot read. An abort is read here, and its body only documented.
@stopping.post("/abort", openapi_extra=_ABORT_BODY)
async def abort(
    app_state: AppStateDependency, name: Annotated[str, Depends(known_name)], request: Request
) -> RequestAccepted:
    """Stop the machine, withdraw the probe and restore the compensation table that was active before the run. This
    request is always accepted, whatever its body; between runs it has no effect. If it has the token of a paired
    client, its name is added to the reason."""
    asked = f" ({name})" if name else ""
    reason = await _abort_reason(request, MAX_REASON - len(asked))
    # A thread of the loop's own pool, which no other request uses: slow requests may occupy all threads of the server.
    await asyncio.to_thread(app_state.control.abort, f"{reason}{asked}")
    return RequestAccepted()


async def _abort_reason(request: Request, longest: int) -> str:
    """Return the reason in the body of an abort on one line, or the default reason if it cannot be read. Refuse only a
    request that breaks off."""
    default = AbortBody().reason
    try:
        body = AbortBody.model_validate_json(await request.body())
    except ClientDisconnect as error:
        raise HTTPException(HTTPStatus.BAD_REQUEST) from error
    except ValidationError:
        return default
    return one_line(body.reason, longest) or default


@with_token.post("/start", status_code=202)
def start(app_state: AppStateDependency, who: Annotated[Requester, permitted(START)], body: StartBody) -> RunStarted:
    """Start a run."""
    return RunStarted(run_id=app_state.control.start(body, who.name))


@with_token.post("/resume-run", status_code=202)
def resume_run(
    app_state: AppStateDependency, who: Annotated[Requester, permitted(RESUME_RUN)], body: ResumeRunBody | None = None
) -> RunStarted:
    """Resume the interrupted run."""
    return RunStarted(run_id=app_state.control.resume_run((body or ResumeRunBody()).source, who.name))


@stopping.post("/hold")
def hold(app_state: AppStateDependency, who: Annotated[Requester, permitted(HOLD)]) -> RequestAccepted:
    """Hold the run in progress: its motion stops, and the run can be resumed."""
    app_state.control.hold(who.name)
    return RequestAccepted()


@with_token.post("/resume")
def resume(app_state: AppStateDependency, who: Annotated[Requester, permitted(RESUME)]) -> RequestAccepted:
    """Continue a run that is held."""
    app_state.control.resume(who.name)
    return RequestAccepted()


@with_token.post("/reset")
def reset(app_state: AppStateDependency, who: Annotated[Requester, permitted(RESET)]) -> RequestAccepted:
    """Acknowledge a fault, an abort or an alarm between runs. Nothing moves."""
    app_state.control.reset(who.name)
    return RequestAccepted()


@with_token.post("/answer")
def answer(
    app_state: AppStateDependency, who: Annotated[Requester, permitted(ANSWER)], body: AnswerBody
) -> RequestAccepted:
    """Answer the open question of the run."""
    app_state.control.answer(body.number, body.yes, who.name)
    return RequestAccepted()


@with_token.post("/tables/restore", status_code=202)
def restore_table(
    app_state: AppStateDependency, who: Annotated[Requester, permitted(RESTORE_TABLE)], body: RestoreBody
) -> RunStarted:
    """Reactivate a stored compensation table. Nothing moves."""
    return RunStarted(run_id=app_state.control.restore_table(body.run_id, body.role, body.source, who.name))


@with_token.post("/unproved-table/restore")
def restore_former(
    app_state: AppStateDependency, who: Annotated[Requester, permitted(RESTORE_FORMER)]
) -> RequestAccepted:
    """Try to reactivate the former table in place of one that was never proved. The run that wrote it can still be
    resumed. Nothing moves."""
    app_state.control.restore_former(who.name)
    return RequestAccepted()


@with_token.post("/give-up-run")
def give_up(app_state: AppStateDependency, who: Annotated[Requester, permitted(GIVE_UP)]) -> RequestAccepted:
    """End the unfinished run without resuming it. If it has left a table active that was never proved, the former table
    is reactivated first; if the controller refuses, the problem document says which table is active and what to do at
    the controller. Nothing moves."""
    app_state.control.give_up(who.name)
    return RequestAccepted()


@with_token.post("/settings/check", dependencies=[permitted(CHECK_SETTINGS)])
def check_settings(app_state: AppStateDependency, body: SettingsBody) -> RequestAccepted:
    """Validate the text of a settings file without using it. If the text is invalid, the problem document names the key
    and the reason."""
    with translated(ConfigurationError):
        parse_settings(body.toml, "settings")
    return RequestAccepted()
