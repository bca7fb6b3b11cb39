"""Requests to the one owner of the machine, the same for every endpoint.

HTTP, the page, the panel gateway, OPC UA and the timer all use a `Control`; none of them knows another. Every method
may be called from any thread and returns at once; `status` and events report what a request leads to.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from queue import Queue
from typing import Any, Protocol

from agent.execution.states import RunState
from agent.runs.run_request import RunRequest, Source


@dataclass(frozen=True)
class Question:
    """Question of the run to a person; the run waits for `Control.answer` with the same `number`."""

    number: int
    text: str
    station: int | None = None


@dataclass(frozen=True)
class Alarm:
    """Condition that needs a reaction. `code`: stable number for panels (docs/reference/alarms.md); `hint`: what to
    do; `where`: device, step, file … of the error."""

    code: int
    text: str
    hint: str = ""
    where: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Status:
    """State of the service at one instant.

    `state`: of the run under way or, between runs, of the last one until it is reset (faulted and aborted are sticky).
    `packml`: its ISA-TR88.00.02 name. `doing`: in words. `fraction` 0…1 and `minutes_left` of machine time by the
    preflight. VE in µm, aligned: of the last accepted estimate, before and with the table. `may`: the requests that
    make sense now (``start``, ``hold``, ``resume``, ``abort``, ``reset``, ``answer``, ``resume_run``).
    `unfinished`: the interrupted run that can be resumed. `written_not_active`: a bank that waits for a restart of
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
    """Event of the service. `number` counts up without gaps while the service lives; `kind`: ``state``,
    ``progress``, ``note``, ``gate``, ``ball``, ``lost`` (a ball that was not found), ``temperature``, ``question``,
    ``alarm``, ``outcome``."""

    number: int
    kind: str
    text: str
    data: Mapping[str, Any]


class Control(Protocol):
    """The owner of the machine."""

    def status(self) -> Status: ...

    def start(self, request: RunRequest) -> str:
        """Start a run and return its identity. Raises Busy, naming the run under way; UserError for a request that
        cannot be carried out; PermissionMissing if a reset or an answer is needed first."""
        ...

    def resume_run(self, source: Source) -> str:
        """Resume the unfinished run and return its identity. Raises as `start`; UserError if there is none."""
        ...

    def restore_table(self, run_id: str, role: str, source: Source) -> str:
        """Reactivate the table that run `run_id` has stored as `role` (``backup``, ``staged``, ``restored``).

        Return the identity of the run that restores it; raises as `start`. Nothing moves."""
        ...

    def hold(self) -> None: ...

    def resume(self) -> None: ...

    def abort(self, reason: str) -> None:
        """Abort the run. Always allowed; without effect between runs."""
        ...

    def reset(self) -> None:
        """Acknowledge a fault: alarms are cleared, the state is idle again. Moves nothing."""
        ...

    def answer(self, number: int, yes: bool) -> None:
        """Answer the open question of that number. Raise UserError for any other number."""
        ...

    def subscribe(self) -> AbstractContextManager[Queue[Event]]:
        """Subscribe to the events from now on; a reader that lags far behind loses the oldest progress events first."""
        ...
