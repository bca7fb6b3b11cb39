"""Bodies of requests and responses, as documented in the OpenAPI document."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from agent.execution.states import RunState
from agent.runs.run_request import RunRequest
from agent.service.control import Status


class RequestBody(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StartBody(RunRequest):
    """Request of a run. `consent`: a person at the machine has confirmed that it may move; without it the service
    decides from permissions, hours and warm-up whether the run may start. null: as in the settings."""

    source: Literal["page", "command line", "timer"] = "page"


class ResumeRunBody(RequestBody):
    source: Literal["page", "command line"] = "page"


class AbortBody(RequestBody):
    reason: str = Field(default="abort pressed", min_length=1, max_length=200)


class AnswerBody(RequestBody):
    """Answer to the question with this `number`."""

    number: PositiveInt
    yes: bool


class RestoreBody(RequestBody):
    """Stored table, as listed by `/api/tables`."""

    run_id: str = Field(max_length=40)
    role: Literal["backup", "staged", "restored"] = "backup"
    source: Literal["page", "command line"] = "page"


class SettingsBody(RequestBody):
    """Text of a settings file to be validated; it is not stored."""

    toml: str = Field(max_length=60_000)


class RunStarted(BaseModel):
    run_id: str


class RequestAccepted(BaseModel):
    """The request was accepted; its effect is reported by status and events."""

    taken: Literal[True] = True


class AlarmView(BaseModel):
    code: int
    text: str
    hint: str
    where: dict[str, str]


class QuestionView(BaseModel):
    number: int
    text: str
    station: int | None


class StatusView(BaseModel):
    """Status as in `agent.service.control.Status`; `event`: number of the last event that it includes."""

    machine: str
    state: RunState
    packml: str
    run_id: str | None
    kind: str | None
    position_set: str | None
    started: str | None
    doing: str
    step: str
    fraction: float
    minutes_left: float | None
    balls: int
    touches: int
    ve_before_um: float | None
    ve_now_um: float | None
    active_bank: int | None
    written_not_active: int | None
    unfinished: str | None
    question: QuestionView | None
    alarms: list[AlarmView]
    may: list[str]
    event: int


class RunSummary(BaseModel):
    """Summary of a run; times in UTC. `report`: true if a report exists."""

    run_id: str
    kind: str
    started: str
    ended: str | None
    state: RunState
    reason: str | None
    software: str
    balls: int
    touches: int
    report: bool


class RunDetails(RunSummary):
    """Run with its request (`asked`), gates and decisions. `accepted`: its table is the reference of later nights."""

    position_set: str
    asked: dict[str, Any] | None
    gates: list[dict[str, Any]]
    decisions: list[dict[str, Any]]
    accepted: bool


class RunPage(BaseModel):
    """Runs, latest first; `before`: parameter for the next page, null if there are no earlier runs."""

    runs: list[RunSummary]
    before: str | None


class TableView(BaseModel):
    run_id: str
    at: str
    role: Literal["backup", "staged", "restored"]
    bank: int
    crc32: str | None
    origin_mm: list[float] | None
    step_mm: list[float] | None
    resolution_mm: float | None
    shape: list[int] | None


class TableList(BaseModel):
    """`active_bank` and `written_not_active` as last read; `kept`: stored tables that can be restored."""

    active_bank: int | None
    written_not_active: int | None
    kept: list[TableView]


def status_view(status: Status, event: int) -> StatusView:
    question = status.question
    alarms = [AlarmView(code=a.code, text=a.text, hint=a.hint, where=dict(a.where)) for a in status.alarms]
    replaced = {
        "question": None if question is None else QuestionView(**vars(question)),
        "alarms": alarms,
        "may": sorted(status.may),
    }
    return StatusView(**{**vars(status), **replaced, "event": event})
