"""Register map of the panel gateway as data; docs/reference/panel-gateway.md shows the same tables.

Addresses are protocol addresses, which count from 0. A 32-bit value takes two registers, the high word first. A text
takes one register per two ASCII characters, the first character in the high byte, and is padded with zeros.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from agent.execution.states import RunState
from agent.runs.run_kinds import KINDS

MAP_VERSION: Final = 1


class Form(Enum):
    U16 = "uint16"
    U32 = "uint32"
    I32 = "int32"
    TEXT = "text"


UNKNOWN: Final = {Form.U16: 0xFFFF, Form.U32: 0xFFFFFFFF, Form.I32: -0x80000000}
"""Register value that means "unknown", for each format."""


@dataclass(frozen=True)
class Register:
    """One value of the register map. `address` is the address of the first register of the value; `words` is the number
    of registers that the value takes."""

    name: str
    address: int
    form: Form
    words: int
    meaning: str

    @property
    def end(self) -> int:
        return self.address + self.words


_WORDS = {Form.U16: 1, Form.U32: 2, Form.I32: 2}


def _block(start: int, *rows: tuple[str, Form, int, str]) -> tuple[Register, ...]:
    """Return values at consecutive addresses, the first of them at `start`. Each row states the name, the format, the
    number of characters (0 if the value is not a text) and the meaning.
    """
    registers = []
    for name, form, characters, meaning in rows:
        registers.append(Register(name, start, form, _WORDS.get(form, characters // 2), meaning))
        start = registers[-1].end
    return tuple(registers)


STATUS: Final = _block(
    0,
    ("map_version", Form.U16, 0, "version of this map: 1"),
    ("heartbeat", Form.U16, 0, "counts up every second while the service is operational"),
    ("flags", Form.U16, 0, "bits, see below"),
    ("state", Form.U16, 0, "see below"),
    ("packml_state", Form.U16, 0, "StateCurrent of ISA-TR88.00.02"),
    ("kind", Form.U16, 0, "1 calibrate, 2 verify, 3 nightly, 0 none"),
    ("may", Form.U16, 0, "requests allowed now, bits see below"),
    ("progress", Form.U16, 0, "0.01 %"),
    ("minutes_left", Form.U32, 0, "0.01 min of machine time"),
    ("ve_before", Form.I32, 0, "nm, VE of the last accepted estimate without table"),
    ("ve_now", Form.I32, 0, "nm, VE of the same estimate with its table"),
    ("balls", Form.U32, 0, "balls measured in this run"),
    ("touches", Form.U32, 0, "touches in this run"),
    ("active_bank", Form.U16, 0, "active bank of the compensation table"),
    ("bank_waiting", Form.U16, 0, "bank written but not active: restart of the controller required"),
    ("alarm_count", Form.U16, 0, "open alarms"),
    ("alarm_1", Form.U16, 0, "code of the first alarm, 0 none; see Alarm codes"),
    ("alarm_2", Form.U16, 0, "code of the second alarm"),
    ("alarm_3", Form.U16, 0, "code of the third alarm"),
    ("alarm_4", Form.U16, 0, "code of the fourth alarm"),
    ("question_number", Form.U32, 0, "open question, 0 none"),
    ("question_station", Form.U16, 0, "station that the question refers to"),
    ("accepted_sequence", Form.U16, 0, "number of the last command handled"),
    ("result", Form.U16, 0, "result of that command, see below"),
    ("position_set", Form.TEXT, 32, "position set of the run"),
    ("run", Form.TEXT, 32, "identity of the run"),
    ("doing", Form.TEXT, 48, "current action in plain text"),
    ("alarm_text", Form.TEXT, 60, "text of the first alarm"),
    ("question_text", Form.TEXT, 80, "text of the open question"),
)
COMMAND: Final = _block(
    200,
    ("command", Form.U16, 0, "see below"),
    ("kind", Form.U16, 0, "start: 1 calibrate, 2 verify, 3 nightly"),
    ("consent", Form.U16, 0, "start: 1 a person at the machine confirms that it may move, 0 no consent"),
    ("full_allowed", Form.U16, 0, "start: 0 as in the settings, 1 no, 2 a night may become a full calibration"),
    ("slot", Form.U16, 0, "start: 0.1 min of machine time, 0 as in the settings"),
    ("stations", Form.U16, 0, "start: bit 0 is station 1 …, 0 as in the settings"),
    ("question_number", Form.U32, 0, "answer: number of the question"),
    ("answer", Form.U16, 0, "answer: 1 yes, 2 no"),
    ("position_set", Form.TEXT, 32, "start: empty as in the settings"),
    ("access_code", Form.U32, 0, "access code shared by all panels; reads as 0"),
    ("sequence", Form.U16, 0, "accepted_sequence + 1; writing it executes the command"),
)
PANEL: Final = _block(260, ("panel_heartbeat", Form.U16, 0, "the panel writes a different value at least every second"))
BLOCKS: Final = (STATUS, COMMAND, PANEL)
ABORT_COIL: Final = 0

IN_COMMAND: Final = {register.name: register for register in COMMAND}

STATE_NUMBERS: Final = {
    RunState.IDLE: 0,
    RunState.PREFLIGHT: 1,
    RunState.MEASURING: 2,
    RunState.HELD: 3,
    RunState.IDENTIFYING: 4,
    RunState.STAGING: 5,
    RunState.ACTIVATING: 6,
    RunState.VERIFYING: 7,
    RunState.RESTORING: 8,
    RunState.COMPLETE: 9,
    RunState.REFUSED: 10,
    RunState.ABORTING: 11,
    RunState.ABORTED: 12,
    RunState.FAULTED: 13,
    RunState.RESUMING: 14,
    RunState.WRITTEN: 15,
}
PACKML_NUMBERS: Final = {
    "Clearing": 1,
    "Stopped": 2,
    "Starting": 3,
    "Idle": 4,
    "Suspended": 5,
    "Execute": 6,
    "Stopping": 7,
    "Aborting": 8,
    "Aborted": 9,
    "Holding": 10,
    "Held": 11,
    "Unholding": 12,
    "Suspending": 13,
    "Unsuspending": 14,
    "Resetting": 15,
    "Completing": 16,
    "Complete": 17,
}
"""Numbers of the PackML states, as in the PackTag StateCurrent; 0 means undefined."""
KIND_NUMBERS: Final[dict[str, int]] = {kind: number for number, kind in enumerate(KINDS, start=1)}
FLAGS: Final = ("running", "alarm", "question", "bank_waiting", "unfinished_run", "panel_alive", "access_code_set",
                "unproved_table")  # fmt: skip
MAY: Final = ("start", "hold", "resume", "abort", "reset", "answer", "resume_run")


class Command(IntEnum):
    """Values of the register `command`, into which a panel writes its command. Abort is also a coil; the value for it
    is provided for panels that cannot write coils."""

    START = 1
    HOLD = 2
    RESUME = 3
    ABORT = 4
    RESET = 5
    ANSWER = 6
    RESUME_RUN = 7


FREE_COMMANDS: Final = frozenset({Command.HOLD, Command.ABORT})
"""Commands that need no access code, because they can only stop motion."""


class Result(IntEnum):
    """Values below 100 of the register `result`, which shows the result of the last command. In this register a value
    of 100 or more is an alarm number."""

    NONE = 0
    DONE = 1
    WRONG_CODE = 10
    NO_CODE_SET = 11
    LOCKED = 12
    UNKNOWN_COMMAND = 13
    VALUE_NOT_ALLOWED = 14


RESULT_TEXTS: Final = {
    Result.NONE: "no command since the start of the service",
    Result.DONE: "done; for a start: the run has started",
    Result.WRONG_CODE: "the access code is wrong",
    Result.NO_CODE_SET: "no access code in the settings: only hold and abort are possible",
    Result.LOCKED: "locked after a wrong access code; wait five seconds",
    Result.UNKNOWN_COMMAND: "unknown command",
    Result.VALUE_NOT_ALLOWED: "a command register holds a value that is not allowed",
}
