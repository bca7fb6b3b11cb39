"""Requests. What moves or writes needs the token; abort needs none, from whoever stands there."""

from __future__ import annotations

from fastapi import APIRouter, Depends

from agent.files import translated
from agent.service.http.app_state import SiteHere
from agent.service.http.guard import require_token
from agent.service.http.models import (
    AbortBody,
    AnswerBody,
    Done,
    RestoreBody,
    ResumeRunBody,
    RunBegun,
    SettingsBody,
    StartBody,
)
from agent.service.http.problems import DOCUMENTED
from agent.settings.schema import parse_settings
from drivers.errors import ConfigurationError

open_to_all = APIRouter(prefix="/api", tags=["asking"], responses=DOCUMENTED)
with_token = APIRouter(prefix="/api", tags=["asking"], responses=DOCUMENTED, dependencies=[Depends(require_token)])


@open_to_all.post("/abort")
def abort(site: SiteHere, body: AbortBody | None = None) -> Done:
    """Stop, withdraw, restore. Always taken; between runs nothing happens."""
    site.control.abort((body or AbortBody()).reason)
    return Done()


@with_token.post("/start", status_code=202)
def start(site: SiteHere, body: StartBody) -> RunBegun:
    return RunBegun(run_id=site.control.start(body))


@with_token.post("/resume-run", status_code=202)
def resume_run(site: SiteHere, body: ResumeRunBody | None = None) -> RunBegun:
    """Go on with the run that broke off."""
    return RunBegun(run_id=site.control.resume_run((body or ResumeRunBody()).source))


@with_token.post("/hold")
def hold(site: SiteHere) -> Done:
    site.control.hold()
    return Done()


@with_token.post("/resume")
def resume(site: SiteHere) -> Done:
    """Go on after a hold."""
    site.control.resume()
    return Done()


@with_token.post("/reset")
def reset(site: SiteHere) -> Done:
    """Acknowledge a fault or an abort. Moves nothing."""
    site.control.reset()
    return Done()


@with_token.post("/answer")
def answer(site: SiteHere, body: AnswerBody) -> Done:
    site.control.answer(body.number, body.yes)
    return Done()


@with_token.post("/tables/restore", status_code=202)
def restore_table(site: SiteHere, body: RestoreBody) -> RunBegun:
    """Have a kept table act again. Nothing moves."""
    return RunBegun(run_id=site.control.restore_table(body.run_id, body.role, body.source))


@with_token.post("/settings/check")
def check_settings(site: SiteHere, body: SettingsBody) -> Done:
    """Whether a settings file would be taken; the problem names key and reason."""
    with translated(ConfigurationError):
        parse_settings(body.toml, "settings")
    return Done()
