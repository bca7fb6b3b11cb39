"""OPC UA nodes, methods and events as data; docs/reference/opc-ua.md shows the same tables.

Names and their grouping follow OPC 40210 (GMSType, but not its CorrectionType) and OPC 40501-1 (ProductionType,
MonitoringType, NotificationType), as far as these specifications define them. The nodes belong to this program's own
namespace and have only base types of OPC UA; the instances of the types of OPC 40001 and OPC 40501-1 are in
`agent.service.opcua.machine_model`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from agent.execution.states import RunState
from agent.service.control import Status

NAMESPACE: Final = "urn:volcal:opcua:1"
ROOT: Final = "Volcal"

Value = str | float | bool | int | Sequence[str] | Sequence[int]
S = RunState

PROGRAM_STATES: Final = {
    S.IDLE: "Ended",
    S.PREFLIGHT: "Initializing",
    S.RESUMING: "Initializing",
    S.MEASURING: "Running",
    S.HELD: "Interrupted",
    S.IDENTIFYING: "Running",
    S.STAGING: "Running",
    S.ACTIVATING: "Running",
    S.VERIFYING: "Running",
    S.RESTORING: "Running",
    S.WRITTEN: "Interrupted",
    S.COMPLETE: "Ended",
    S.REFUSED: "Ended",
    S.ABORTING: "Aborted",
    S.ABORTED: "Aborted",
    S.FAULTED: "Aborted",
}
"""State of ProductionStateMachineType (OPC 40501-1, 8.4.8) for each state of a run."""


@dataclass(frozen=True)
class Variable:
    """Readable OPC UA node. `of` is a function that returns the value of the node from the status of the service.
    `path` is the path of the node relative to the root object. `form` is the name of the built-in OPC UA type, followed
    by [] if the value is an array."""

    path: str
    form: str
    meaning: str
    of: Callable[[Status], Value]


@dataclass(frozen=True)
class Argument:
    name: str
    form: str
    meaning: str


@dataclass(frozen=True)
class Method:
    """OPC UA method. `free` is True if the method can be called without the access token of the service, because it can
    only stop motion."""

    name: str
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    meaning: str
    free: bool = False


@dataclass(frozen=True)
class EventType:
    name: str
    severity: int
    fields: tuple[Argument, ...]
    meaning: str


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _count(value: int | None) -> int:
    return -1 if value is None else value


VARIABLES: Final = (
    Variable("Identification/Name", "String", "name of the machine", lambda s: s.machine),
    Variable("Monitoring/PackMLState", "String", "PackML state (ISA-TR88.00.02)", lambda s: s.packml),
    Variable("Monitoring/RunState", "String", "run state", lambda s: s.state.value),
    Variable("Monitoring/Doing", "String", "current action in plain text", lambda s: s.doing),
    Variable("Monitoring/Step", "String", "key of the step", lambda s: s.step),
    Variable("Monitoring/May", "String[]", "methods allowed now", lambda s: sorted(s.may)),
    Variable(
        "Monitoring/ActiveBank",
        "Int32",
        "active bank of the compensation table, -1 unknown",
        lambda s: _count(s.active_bank),
    ),
    Variable(
        "Monitoring/BankWaiting",
        "Int32",
        "bank written but not active: restart of the controller required; -1 none",
        lambda s: _count(s.written_not_active),
    ),
    Variable(
        "Monitoring/UnprovedTable",
        "String",
        "which table is active although it was never proved, and the ways out; empty if none",
        lambda s: "" if s.unproved is None else f"{s.unproved.situation}; {s.unproved.way_out}",
    ),
    Variable("Production/ActiveProgram/Name", "String", "position set", lambda s: s.position_set or ""),
    Variable(
        "Production/ActiveProgram/State",
        "String",
        "Initializing, Running, Interrupted, Ended or Aborted",
        lambda s: PROGRAM_STATES[s.state],
    ),
    Variable("Production/Job/Identifier", "String", "identity of the run", lambda s: s.run_id or ""),
    Variable("Production/Job/Kind", "String", "calibrate, verify or nightly", lambda s: s.kind or ""),
    Variable("Production/Job/Started", "String", "start time in ISO 8601", lambda s: s.started or ""),
    Variable("Production/Job/Progress", "Double", "0 to 1", lambda s: s.fraction),
    Variable("Production/Job/RemainingTime", "Double", "minutes of machine time", lambda s: _number(s.minutes_left)),
    Variable("Production/Job/Balls", "Int32", "balls measured", lambda s: s.balls),
    Variable("Production/Job/Touches", "Int32", "touches", lambda s: s.touches),
    Variable(
        "Production/Job/Unfinished", "String", "interrupted run that ResumeRun resumes", lambda s: s.unfinished or ""
    ),
    Variable(
        "ResultManagement/Results/VEBefore",
        "Double",
        "µm, VE of the last accepted estimate without table, aligned",
        lambda s: _number(s.ve_before_um),
    ),
    Variable(
        "ResultManagement/Results/VENow",
        "Double",
        "µm, VE of the same estimate with its table",
        lambda s: _number(s.ve_now_um),
    ),
    Variable(
        "Notification/AlarmCodes", "Int32[]", "open alarms, see Alarm codes", lambda s: [a.code for a in s.alarms]
    ),
    Variable("Notification/AlarmTexts", "String[]", "texts of the open alarms", lambda s: [a.text for a in s.alarms]),
    Variable("Notification/AlarmHints", "String[]", "remedy", lambda s: [a.hint for a in s.alarms]),
    Variable(
        "Notification/QuestionNumber",
        "Int32",
        "number of the open question for Answer, -1 none",
        lambda s: s.question.number if s.question else -1,
    ),
    Variable(
        "Notification/QuestionText",
        "String",
        "text of the open question",
        lambda s: s.question.text if s.question else "",
    ),
)

OUTCOME: Final = "ResultManagement/Results/Outcome"
REFUSED_CODE: Final = "Notification/LastRefusalCode"
REFUSED_TEXT: Final = "Notification/LastRefusalText"
OWN_VARIABLES: Final = (
    (OUTCOME, "String", "outcome of the last run since the start of the service, as JSON"),
    (REFUSED_CODE, "Int32", "alarm code of the last refused method call; 0 none"),
    (REFUSED_TEXT, "String", "text of the last refusal with its remedy"),
)
"""Path, form and meaning of the variables that do not come from the status but are maintained by the server."""

METHODS: Final = (
    Method(
        "Start",
        (
            Argument("Kind", "String", "calibrate, verify or nightly"),
            Argument("PositionSet", "String", "names joined by +; empty: as in the settings"),
            Argument("Stations", "Int32[]", "empty: as in the settings"),
            Argument("SlotMinutes", "Double", "0: as in the settings"),
            Argument("FullAllowed", "Boolean", "a night may become a full calibration"),
            Argument("Consent", "Boolean", "a person at the machine confirms that it may move"),
        ),
        (Argument("Identifier", "String", "identity of the run started"),),
        "start a run",
    ),
    Method(
        "ResumeRun",
        (),
        (Argument("Identifier", "String", "identity of the run started"),),
        "resume the interrupted run",
    ),
    Method("Hold", (), (), "hold the run", free=True),
    Method("Resume", (), (), "continue after a hold"),
    Method("Abort", (Argument("Reason", "String", "reason recorded in the journal"),), (), "abort the run", free=True),
    Method("Reset", (), (), "acknowledge a fault, an abort or an alarm between runs; nothing moves"),
    Method(
        "Answer",
        (Argument("Number", "Int32", "number of the question"), Argument("Yes", "Boolean", "the answer")),
        (),
        "answer the open question",
    ),
)

STATE_EVENT: Final = EventType(
    "StateChangeEventType",
    100,
    (Argument("PackMLState", "String", "new state"), Argument("RunState", "String", "new state")),
    "change of state",
)
ALARM_EVENT: Final = EventType(
    "AlarmEventType",
    800,
    (Argument("Code", "Int32", "see Alarm codes"), Argument("Hint", "String", "remedy")),
    "new alarm; its text is the Message",
)
EVENT_TYPES: Final = (STATE_EVENT, ALARM_EVENT)
