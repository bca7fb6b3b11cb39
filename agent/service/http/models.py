"""What requests carry and what they are answered with, as the OpenAPI document shows it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from agent.execution.states import RunState
from agent.runs.run_request import RunRequest
from agent.service.control import Status


class Body(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StartBody(RunRequest):
    """`consent`: somebody stands at the machine and has confirmed that it may move. Without it the service decides from
    permissions, hours and warm-up whether anything begins. None: as the settings say."""

    source: Literal["page", "command line", "timer"] = "page"


class ResumeRunBody(Body):
    source: Literal["page", "command line"] = "page"


class AbortBody(Body):
    reason: str = Field(default="abort pressed", min_length=1, max_length=200)


class AnswerBody(Body):
    """`number`: of the question that is answered."""

    number: PositiveInt
    yes: bool


class RestoreBody(Body):
    """A table as `/api/tables` lists it."""

    run_id: str = Field(max_length=40)
    role: Literal["backup", "staged", "restored"] = "backup"
    source: Literal["page", "command line"] = "page"


class SettingsBody(Body):
    """The text of a settings file, to be checked and not kept."""

    toml: str = Field(max_length=60_000)


class RunBegun(BaseModel):
    run_id: str


class Done(BaseModel):
    """The request was taken; what it leads to is told by status and events."""

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
    """`agent.service.control.Status`; `event`: number of the last event that it includes."""

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
    """UTC times; `report`: whether there is one."""

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
    """`asked`: by whom and for what; `accepted`: its table is the one that nights are compared with."""

    position_set: str
    asked: dict[str, Any] | None
    gates: list[dict[str, Any]]
    decisions: list[dict[str, Any]]
    accepted: bool


class RunPage(BaseModel):
    """The latest first; `before`: ask with it for those before, null where there are none."""

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


class Tables(BaseModel):
    """`active_bank` and `written_not_active` as the last run read them; `kept`: what can be restored."""

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
