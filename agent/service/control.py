"""Interface through which every endpoint sends requests to the owner of the machine.

The HTTP endpoint, the web page, the panel gateway, the OPC UA server and the timer that starts nightly runs all use a
`Control` and are independent of each other. Every method may be called from any thread and does not wait for the run.
The effect of a request appears in `status` and in the events.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from queue import Queue
from typing import Any, Protocol

from agent.execution.states import RunState
from agent.notifications.dispatcher import ReceiverState
from agent.results.run_verdict import RunVerdict
from agent.runs.run_request import RunRequest, Source
from agent.runs.unproved_table import UnprovedTable
from drivers.roles import PlacementRequest


@dataclass(frozen=True)
class Question:
    """Question that a run asks a person. The run waits until `Control.answer` is called with the `number` of the
    question. `placement` is given if the artefact is to be placed by hand."""

    number: int
    text: str
    station: int | None = None
    placement: PlacementRequest | None = None


@dataclass(frozen=True)
class Alarm:
    """Condition that requires a reaction. `code` is a stable number for panels (docs/reference/alarms.md). `hint`
    states the action to take. `where` names the device, step, file or other location of the error."""

    code: int
    text: str
    hint: str = ""
    where: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class LinkState:
    """Link of the device `device`. `problem` is the reason why the device cannot be reached; it is empty if it can.
    `unread` is the reason why the device is not read between runs, in which case it is not known whether it answers."""

    device: str
    problem: str = ""
    unread: str = ""

    @property
    def ok(self) -> bool:
        return not self.problem and not self.unread


@dataclass(frozen=True)
class Status:
    """State of the service at one instant.

    - `state` is the state of the run in progress or, between runs, the final state of the last run until a reset. Only
      a reset leaves the states faulted and aborted.
    - `packml` is the ISA-TR88.00.02 name of the state.
    - `doing` is the current activity in plain words.
    - `fraction` is the completed part of the run, from 0 to 1.
    - `minutes_left` is the remaining machine time in min, as computed by the preflight; None before its end.
    - `phase` is the phase of the run in progress: ``preflight``, one of `agent.planning.run_phases.MOVING_PHASES`, or
      the state in which the machine does not move, such as ``identifying``; empty between runs. `phase_fraction` is its
      completed part, from 0 to 1, and `phase_minutes_left` its remaining time in min, machine time or, in a preflight,
      the time of the computation; None if it is not known.
    - `simulated_steps` is the number of steps that the preflight of the run has simulated so far.
    - `axis_mm` are the axis positions in mm at the end of the last motion of the run, after a touch those at the trip;
      None before the first motion and between runs.
    - `source` is the source of the request for the run, and `by` the name of the client that sent it if it is known;
      both are empty after a reset and after a restart of the service.
    - `ve_before_um` and `ve_now_um` are the volumetric errors (VE) without and with the compensation table, according
      to the last accepted estimate; both are in µm, after the best-fitting rigid motion is removed.
    - `may` contains the requests that are allowed now (``start``, ``hold``, ``resume``, ``abort``, ``reset``,
      ``answer``, ``resume_run``, ``restore_former``, ``give_up``).
    - `unfinished` is the identity of the interrupted run that can be resumed.
    - `unproved` is the table that is active although it was never proved, or None.
    - `verdict` is the verdict on the run that has ended, until a reset or the next run; otherwise None.
    - `active_bank` is the bank that the controller was last seen to apply. It is None if it is not known;
      `read_problem` then says why the controller could not be read.
    - `read_age_s` is the time in s since it was read between runs; None if it never was, or while a run is in progress.
    - `temperatures_c` are the readings of the thermometer in °C by sensor, and `temperatures_age_s` is the time in s
      since they were read between runs; none and None if they never were, or while a run is in progress.
    - `links` says of each device whether it answered when it was last asked, or why it is not read between runs.
    - `receivers` says of each channel of the notifications how many notices wait, whether it delivers everything, only
      in part or nothing, and since when and why not everything.
    - `written_not_active` is the bank whose table has been written but becomes active only when the controller is
      restarted.
    """

    machine: str
    state: RunState
    packml: str
    run_id: str | None = None
    kind: str | None = None
    position_set: str | None = None
    started: str | None = None
    source: str = ""
    by: str = ""
    doing: str = ""
    step: str = ""
    fraction: float = 0.0
    minutes_left: float | None = None
    phase: str = ""
    phase_fraction: float | None = None
    phase_minutes_left: float | None = None
    simulated_steps: int = 0
    balls: int = 0
    touches: int = 0
    axis_mm: tuple[float, float, float] | None = None
    ve_before_um: float | None = None
    ve_now_um: float | None = None
    active_bank: int | None = None
    read_age_s: float | None = None
    read_problem: str = ""
    temperatures_c: Mapping[str, float] = field(default_factory=dict)
    temperatures_age_s: float | None = None
    links: tuple[LinkState, ...] = ()
    receivers: tuple[ReceiverState, ...] = ()
    written_not_active: int | None = None
    unfinished: str | None = None
    unproved: UnprovedTable | None = None
    question: Question | None = None
    verdict: RunVerdict | None = None
    alarms: tuple[Alarm, ...] = ()
    may: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Event:
    """Event of the service.

    `number` increases by one with each event while the service runs. `kind` is ``state``, ``progress``, ``note``,
    ``gate``, ``ball``, ``lost`` (a ball that was not found), ``temperature``, ``question``, ``alarm`` or ``outcome``.
    """

    number: int
    kind: str
    text: str
    data: Mapping[str, Any]


class Control(Protocol):
    """Interface through which every endpoint uses the owner of the machine, the object that alone controls it.

    `by` is the name of the client that sent the request, which is recorded; it is empty if the client has no name.
    """

    def status(self) -> Status: ...

    def start(self, request: RunRequest, by: str = "") -> str:
        """Start a run and return its identity.

        Raise Busy, with the name of the run in progress, if another run is in progress. Raise UserError if the request
        cannot be carried out, DeviceError if the machine cannot be reached, and ResetMissing if a reset is needed
        first.

        A request without consent has further conditions. Raise
        PermissionMissing if the controller does not permit motion. Raise GateRefused if the present hour is not
        permitted or the machine has not warmed up yet.
        """
        ...

    def resume_run(self, source: Source, by: str = "") -> str:
        """Resume the interrupted run and return its identity.

        Raise UserError if there is no interrupted run, and Busy, DeviceError or PermissionMissing in the same cases as
        `start`.
        """
        ...

    def restore_table(self, run_id: str, role: str, source: Source, by: str = "") -> str:
        """Reactivate the compensation table that the run `run_id` stored in the role `role` (``backup``, ``staged`` or
        ``restored``).

        Return the identity of the new run that restores the table. Raise Busy, UserError or PermissionMissing in the
        same cases as `start`. The machine does not move.
        """
        ...

    def restore_former(self, by: str = "") -> None:
        """Try to reactivate the former table in place of an unproved one. The run that wrote that one can still be
        resumed, which proves it. Nothing moves.

        Raise StoreError, with the reason and the other ways out, if the controller does not reactivate it, and Busy,
        NotAllowedInState or DeviceError in the same cases as `start`.
        """
        ...

    def give_up(self, by: str = "") -> None:
        """Do the same as `restore_former`, and end the run: it can no longer be resumed.

        Raise StoreError if the former table could not be reactivated; its text says which table is active, and its hint
        what the operator must do at the controller.
        """
        ...

    def hold(self, by: str = "") -> None:
        """Hold the run in progress. A run that is held, also one that is about to continue, stays held."""
        ...

    def resume(self, by: str = "") -> None: ...

    def abort(self, reason: str) -> None:
        """Abort the run in progress. This request is always allowed; between runs it has no effect."""
        ...

    def reset(self, by: str = "") -> None:
        """Acknowledge a fault, an abort or an alarm between runs, and return to the state idle. Nothing moves.

        The alarms are cleared, except that of an endpoint that is not open, and that of a comparison of the controller
        with the journal if the comparison cannot be made again now or finds the same.
        """
        ...

    def answer(self, number: int, yes: bool, by: str = "") -> None:
        """Answer the open question that has the number `number`. Raise UserError if no question with this number is
        open."""
        ...

    def subscribe(self) -> AbstractContextManager[Queue[Event]]:
        """Subscribe to all events from now on; they arrive in a queue.

        If the subscriber reads too slowly, its queue drops events, beginning with the oldest progress events.
        """
        ...
