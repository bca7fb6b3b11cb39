"""What everybody may ask of the one owner of the machine, whichever door they come through.

HTTP, the page, the panel gateway, OPC UA and the timer all speak to a `Control`; none of them knows another. Every
method may be called from any thread and returns at once; what a request leads to is told by `status` and by events.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import Enum
from queue import Queue
from typing import Any, Literal, Protocol

from agent.execution.states import RunState

KindName = Literal["calibrate", "verify", "nightly"]
KINDS: tuple[KindName, ...] = ("calibrate", "verify", "nightly")


class Source(Enum):
    """Who asked: it is written into the journal with the run."""

    TIMER = "timer"
    PAGE = "page"
    PANEL = "panel"
    OPC_UA = "opc ua"
    COMMAND = "command line"


@dataclass(frozen=True)
class StartRequest:
    """A run that somebody wants. None: as the settings say.

    `consent`: a person stands at the machine and has confirmed that it may move; a timer never has it, and the agent
    then decides from permissions alone. `full_allowed`: a night may become a full calibration.
    """

    kind: KindName
    source: Source
    position_set: str | None = None
    stations: tuple[int, ...] | None = None
    slot_minutes: float | None = None
    full_allowed: bool | None = None
    consent: bool = False


@dataclass(frozen=True)
class Question:
    """What the run wants to know of a person; it waits for `Control.answer` with the same `number`."""

    number: int
    text: str
    station: int | None = None


@dataclass(frozen=True)
class Alarm:
    """Something that needs an answer. `code`: stable number for panels (docs/reference/alarms.md); `hint`: what to
    do; `where`: device, step, file … of the error."""

    code: int
    text: str
    hint: str = ""
    where: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Status:
    """The whole of it at one instant; frozen, so that it can be handed to anybody.

    `state`: of the run under way or, between runs, of the last one until it is reset (faulted and aborted are sticky).
    `packml`: its ISA-TR88.00.02 name. `doing`: in words. `fraction` 0…1 and `minutes_left` of machine time by the
    rehearsal. VE in µm, aligned: of the last accepted estimate, before and with the table. `may`: the requests that
    make sense now (``start``, ``hold``, ``resume``, ``abort``, ``reset``, ``answer``, ``resume_run``).
    `unfinished`: the run that broke off and can be resumed. `written_not_active`: a bank that waits for a restart of
    the controller.
    """

    machine: str
    state: RunState
    packml: str
    run_id: str | None = None
    kind: str | None = None
    position_set: str | None = None
    started: str | None = None
    doing: str = ""
    step: str = ""
    fraction: float = 0.0
    minutes_left: float | None = None
    balls: int = 0
    touches: int = 0
    ve_before_um: float | None = None
    ve_now_um: float | None = None
    active_bank: int | None = None
    written_not_active: int | None = None
    unfinished: str | None = None
    question: Question | None = None
    alarms: tuple[Alarm, ...] = ()
    may: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Event:
    """One thing that happened. `number` counts up without gaps while the service lives; `kind`: ``state``,
    ``progress``, ``note``, ``gate``, ``ball``, ``lost`` (a ball that was not found), ``temperature``, ``question``,
    ``alarm``, ``outcome``."""

    number: int
    kind: str
    text: str
    data: Mapping[str, Any]


class Control(Protocol):
    """The owner of the machine."""

    def status(self) -> Status: ...

    def start(self, request: StartRequest) -> str:
        """The identity of the run that has begun. Raises Busy, naming the run under way; UserError for a request that
        cannot be; PermissionMissing where reset or an answer is wanted first."""
        ...

    def resume_run(self, source: Source) -> str:
        """Go on with the unfinished run. Raises as `start`; UserError where there is none."""
        ...

    def restore_table(self, run_id: str, role: str, source: Source) -> str:
        """Have a table act again that run `run_id` has kept as `role` (``backup``, ``staged``, ``restored``). Raises as
        `start`; the identity is that of the run that restores it. Nothing moves."""
        ...

    def hold(self) -> None: ...

    def resume(self) -> None: ...

    def abort(self, reason: str) -> None:
        """Always allowed; nothing happens between runs."""
        ...

    def reset(self) -> None:
        """Acknowledge a fault: alarms are cleared, the state is idle again. Moves nothing."""
        ...

    def answer(self, number: int, yes: bool) -> None:
        """To the open question of that number. UserError for any other."""
        ...

    def subscribe(self) -> AbstractContextManager[Queue[Event]]:
        """Events from now on; a reader that lags far behind loses the oldest progress events first."""
        ...
