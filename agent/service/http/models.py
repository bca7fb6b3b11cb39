"""Models of the bodies of requests and responses, from which the OpenAPI document is generated."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from agent.execution.states import RunState
from agent.runs.run_request import RunRequest
from agent.service.access.pairing_codes import DIGITS, MAX_MINUTES
from agent.service.access.roles import Role
from agent.service.control import Status


class RequestBody(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StartBody(RunRequest):
    """Request for a run. A value of null means that the value is taken from the settings.

    `consent` is true if a person at the machine has confirmed that the machine may move. Without consent the service
    decides from permissions, permitted hours and warm-up whether the run may start.
    """

    source: Literal["page", "command line", "timer"] = "page"


class ResumeRunBody(RequestBody):
    source: Literal["page", "command line"] = "page"


class AbortBody(BaseModel):
    """Reason of an abort. A longer one is shortened to 200 characters. If the body or the reason cannot be read, the
    abort is carried out with the default reason."""

    reason: str = "abort pressed"


class AnswerBody(RequestBody):
    """Answer to the question that has this `number`."""

    number: PositiveInt
    yes: bool


class RestoreBody(RequestBody):
    """Stored compensation table to be reactivated, identified by the values that `/api/tables` lists."""

    run_id: str = Field(max_length=40)
    role: Literal["backup", "staged", "restored"] = "backup"
    source: Literal["page", "command line"] = "page"


class SettingsBody(RequestBody):
    """Text of a settings file to be validated. The text is not stored."""

    toml: str = Field(max_length=60_000)


class PairingCodeBody(RequestBody):
    """Client to be paired: its role, its name (null: one is made from the role), and the validity of the code in
    min."""

    role: Role = "operator"
    name: str | None = Field(default=None, max_length=200)
    minutes: float = Field(default=5.0, ge=1.0, le=MAX_MINUTES)


class PairBody(RequestBody):
    code: str = Field(pattern=rf"^[0-9]{{{DIGITS}}}$")


class RevokeBody(RequestBody):
    name: str = Field(min_length=1, max_length=200)


class PairingCode(BaseModel):
    """Code that a client can exchange for a token of its own until `ends` (UTC). `address` is the page with the code,
    `picture` its QR code (data URI of an SVG), and `reachable` is false if only this computer reaches the address."""

    code: str
    ends: str
    role: Role
    name: str
    address: str
    picture: str
    reachable: bool


class AccessView(BaseModel):
    """Client that has the token of the request. `name` is empty for the token of the machine. `may` lists the requests
    that its role permits, by the names that the status uses; the state of the run may still forbid them."""

    role: Role
    name: str
    may: list[str]


class PairedView(AccessView):
    """Client that was just paired, with its token. The token is not told again."""

    token: str


class PairedClientView(BaseModel):
    """Paired client, with the UTC time of its pairing."""

    name: str
    role: Role
    paired: str


class PairedClientList(BaseModel):
    clients: list[PairedClientView]


class RunStarted(BaseModel):
    run_id: str


class RequestAccepted(BaseModel):
    """Confirmation that the request was accepted. Its effect is reported by the status and the events."""

    taken: Literal[True] = True


class AlarmView(BaseModel):
    code: int
    text: str
    hint: str
    where: dict[str, str]


class BallToPlaceView(BaseModel):
    """Axis positions in mm at which the centre of the ball is to be."""

    ball: int
    position_mm: tuple[float, float, float]


class PlacementView(BaseModel):
    """Position in which the artefact is to be placed by hand. The first of the `balls` is measured first. `refused` is
    the reason for which the last placement was refused; it is empty if there was none."""

    azimuth_deg: float
    elevation_deg: float
    balls: list[BallToPlaceView]
    refused: str
    refused_ball: int | None


class QuestionView(BaseModel):
    """Open question. `placement` is given if the artefact is to be placed by hand."""

    number: int
    text: str
    station: int | None
    placement: PlacementView | None = None


class UnprovedTableView(BaseModel):
    """Table that is active although it was never proved. `former_bank` was active before (0: no compensation).
    `provable` is true if the run can be resumed and then proves its table. `situation` says in words what is active,
    and `way_out` the ways out in their order, as commands of the command line."""

    run_id: str
    bank: int
    former_bank: int
    provable: bool
    situation: str
    way_out: str


class LinkView(BaseModel):
    """Link of a device; `problem` says why it does not answer, and is empty if it does. `unread` says why the device is
    not read between runs, and is empty if it is."""

    device: str
    ok: bool
    problem: str
    unread: str


class ReceiverView(BaseModel):
    """Channel of the notifications. `waiting` is the number of notices that it has not delivered yet; `delivery` says
    whether it delivers everything, only in part or nothing; `problem` says why it does not deliver everything, and
    `since` since when in UTC; both are empty if it does."""

    channel: Literal["mqtt", "webhook", "mail"]
    waiting: int
    delivery: Literal["delivers", "partial", "fails"]
    problem: str
    since: str


class VerdictView(BaseModel):
    """Verdict on a run: a stable `name`, its colour and shape on the page (`look`, `sign`), and English texts."""

    name: str
    look: Literal["done", "quiet", "busy", "held", "refused", "fault"]
    sign: str
    word: str
    sentence: str


class StatusView(BaseModel):
    """Status of the service, with the fields of `agent.service.control.Status`. `event` is the number of the last event
    that the status includes."""

    machine: str
    state: RunState
    packml: str
    run_id: str | None
    kind: str | None
    position_set: str | None
    started: str | None
    source: str
    by: str
    doing: str
    step: str
    fraction: float
    minutes_left: float | None
    phase: str
    phase_fraction: float | None
    phase_minutes_left: float | None
    simulated_steps: int
    balls: int
    touches: int
    axis_mm: tuple[float, float, float] | None
    ve_before_um: float | None
    ve_now_um: float | None
    active_bank: int | None
    read_age_s: float | None
    read_problem: str
    temperatures_c: dict[str, float]
    temperatures_age_s: float | None
    links: list[LinkView]
    receivers: list[ReceiverView]
    written_not_active: int | None
    unfinished: str | None
    unproved: UnprovedTableView | None
    question: QuestionView | None
    verdict: VerdictView | None
    alarms: list[AlarmView]
    may: list[str]
    event: int


class RunSummary(BaseModel):
    """Summary of a run. The times are in UTC. `report` is true if a report exists.

    `ve_um` and `vce_um` are the volumetric errors in µm without a table (VE) and with the one that is active at the end
    of the run (VCE); `held_out_before_um` and `held_out_after_um` are the rms residuals in µm of the held-out balls
    with the former and with the new table.
    """

    run_id: str
    kind: str
    started: str
    ended: str | None
    state: RunState
    reason: str | None
    software: str
    balls: int
    touches: int
    machine_minutes: float | None
    verdict: VerdictView
    ve_um: float | None
    vce_um: float | None
    held_out_before_um: float | None
    held_out_after_um: float | None
    report: bool


class RunDetails(RunSummary):
    """Run with its request (`asked`), its gates and its decisions. `accepted` is true if the table of the run was
    accepted, so that later nightly runs refer to it."""

    position_set: str
    asked: dict[str, Any] | None
    gates: list[dict[str, Any]]
    decisions: list[dict[str, Any]]
    accepted: bool


class RunPage(BaseModel):
    """Page of runs, the latest first. `before` is the parameter for the next page; it is null if there are no earlier
    runs."""

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
    """Active bank and stored compensation tables. `active_bank` and `written_not_active` (bank whose table becomes
    active only at a restart of the controller) are the values last read from the controller; `kept` lists the stored
    tables that can be restored."""

    active_bank: int | None
    written_not_active: int | None
    kept: list[TableView]


def status_view(status: Status, event: int) -> StatusView:
    verdict = None if status.verdict is None else VerdictView(**status.verdict.as_json())
    document = {**vars(status), "may": sorted(status.may), "verdict": verdict, "event": event}
    return StatusView.model_validate(document, from_attributes=True)
