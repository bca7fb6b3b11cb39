"""Status of the service. It is assembled from the announcements of the run (state, progress and notes) and from its
steps."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import structlog

from agent.execution.run_state import Announcement
from agent.execution.states import PACKML, RunState
from agent.execution.steps import (
    ActivateBank,
    MoveTo,
    ReadActiveBank,
    ReadTemperatures,
    Record,
    Retrace,
    Step,
    TouchTowards,
)
from agent.notifications.dispatcher import ReceiverState
from agent.planning.run_phases import HOMING, PREFLIGHT, PROBE_CHECK, QUALIFICATION, RETURN, REVERSAL, VERIFICATION
from agent.results.run_outcome import Outcome
from agent.results.run_requester import BY, requester_of
from agent.results.run_verdict import RunVerdict, verdict_of
from agent.runs.reconcile_result import CompensationState, Reconciliation
from agent.runs.run_request import Source
from agent.runs.unproved_table import UnprovedTable
from agent.service.alarms import alarm_of
from agent.service.allowed_requests import AT_REST, allowed_in
from agent.service.control import Alarm, Question, Status
from agent.service.state.controller_reading import ControllerReading
from agent.service.state.event_log import EventLog
from agent.service.state.idle_alarms import ENDPOINT, IdleAlarms
from drivers.clock import RealClock, utc_timestamp
from drivers.errors import StoreError
from drivers.roles import Miss, Touch

log = structlog.get_logger()
S = RunState
_STATES: dict[RunState, str] = {
    S.IDLE: "ready to start",
    S.PREFLIGHT: "preflight: simulating the whole run; nothing moves",
    S.RESUMING: "preflight: simulating the rest of the interrupted run; nothing moves",
    S.MEASURING: "measuring",
    S.HELD: "held",
    S.IDENTIFYING: "identifying the errors of the machine",
    S.STAGING: "writing the new table into the inactive bank",
    S.ACTIVATING: "activating the new table",
    S.VERIFYING: "verifying with the new table active",
    S.RESTORING: "reactivating the previous table",
    S.WRITTEN: "written, not active: waiting for the controller to be restarted or referenced",
    S.COMPLETE: "complete",
    S.REFUSED: "refused; the machine is unchanged",
    S.ABORTING: "stopping, withdrawing, restoring the previous table",
    S.ABORTED: "aborted",
    S.FAULTED: "fault; waiting for a reset",
}
_PHASES = {
    PROBE_CHECK: "checking the probe",
    QUALIFICATION: "qualifying the stylus",
    REVERSAL: "measuring the lost motion at reversal",
    HOMING: "measuring the scatter of the homing",
    RETURN: "returning to where the run was interrupted",
}
"""Words of the phases that are measured before the first position, and of the return of a resumed run."""
_NO_PHASE = {"phase": "", "phase_fraction": None, "phase_minutes_left": None}
_PROGRESS = ("fraction", "minutes_left", "phase", "phase_fraction", "phase_minutes_left", "simulated_steps")
_UNEXPECTED = (CompensationState.CHANGED, CompensationState.LOST, CompensationState.UNPROVED)
"""States in which the active compensation is not the one whose volumetric error is known."""
_KEY = re.compile(
    r"(?P<phase>[\w-]+)(/station-(?P<station>\d+))?(/az(?P<az>-?[\d.]+)-el(?P<el>-?[\d.]+))?(/ball-(?P<ball>\d+))?"
)
_MOVING = frozenset({S.MEASURING, S.VERIFYING, S.HELD})
_STILL = frozenset(RunState) - _MOVING - {S.PREFLIGHT, S.RESUMING}


@dataclass(frozen=True)
class IdleStatus:
    """State of the machine between runs, read from the journal.

    `ve_before_um` and `ve_now_um` are the volumetric errors (VE) without and with the compensation table, according to
    the last accepted estimate. They are in µm, after the best-fitting rigid motion is removed.
    """

    ve_before_um: float | None = None
    ve_now_um: float | None = None
    active_bank: int | None = None
    written_not_active: int | None = None
    unfinished: str | None = None
    unproved: UnprovedTable | None = None


@dataclass
class StatusBoard:
    """Current status of the service, from which all endpoints read. Any thread may read it. Every change of the state
    is published as an event. Alarms that arise between runs are recorded in `kept`.

    Two kinds of these alarms outlast a reset. That of an endpoint that is not open stands until the service ends. That
    of a comparison of the controller with the journal ends with the next comparison, which a reset asks for: its cause
    may still stand.
    """

    machine: str
    event_log: EventLog
    now: Callable[[], float] = field(default_factory=lambda: RealClock().now)
    kept: IdleAlarms | None = None
    _read_at_s: float | None = None
    _temperatures_at_s: float | None = None
    _unexpected: bool = False
    _of_endpoints: tuple[Alarm, ...] = ()
    _of_comparisons: tuple[Alarm, ...] = ()
    _acknowledged: tuple[Alarm, ...] = ()
    _status: Status = field(init=False)

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._status = Status(self.machine, RunState.IDLE, PACKML[RunState.IDLE])

    @property
    def state(self) -> RunState:
        return self._status.state

    def status(self) -> Status:
        now = self._status
        question_open, unfinished = now.question is not None, now.unfinished is not None
        unproved, alarm_open = now.unproved is not None, _resettable(now.alarms)
        may = allowed_in(
            now.state, unfinished=unfinished, question_open=question_open, unproved=unproved, alarm_open=alarm_open
        )
        at_rest = now.state in AT_REST
        known = now.active_bank is not None and not self._unexpected
        temperatures_age_s = self._age_s(self._temperatures_at_s) if at_rest else None
        return replace(
            now,
            may=may,
            read_age_s=self._age_s(self._read_at_s) if at_rest else None,
            temperatures_c={} if temperatures_age_s is None else now.temperatures_c,
            temperatures_age_s=temperatures_age_s,
            ve_now_um=now.ve_now_um if known or not at_rest else None,
        )

    def _age_s(self, read_at_s: float | None) -> float | None:
        return None if read_at_s is None else max(self.now() - read_at_s, 0.0)

    # ------------------------------------------------------------------ between runs

    def set_machine(self, machine: str) -> None:
        """Set the name of the machine for the next runs."""
        self._change(machine=machine)

    def show_idle(self, idle: IdleStatus) -> None:
        self._change(**vars(idle))

    def show_measured(self, balls: int, touches: int) -> None:
        """Show the numbers of balls and touches that the journal has of the run that has ended."""
        self._change(balls=balls, touches=touches)

    def show_bank(self, bank: int | None, problem: str = "") -> None:
        """Show the bank that was just seen to be active. If `bank` is None, it is not known; `problem` says why."""
        if bank is not None:
            self._read_at_s = self.now()
        self._change(active_bank=bank, read_problem=problem)

    def show_receiver(self, shown: ReceiverState) -> None:
        """Show the state of a channel of the notifications."""
        with self._lock:
            others = (one for one in self._status.receivers if one.channel != shown.channel)
            receivers = tuple(sorted((*others, shown), key=lambda one: one.channel))
            self._status = replace(self._status, receivers=receivers)

    def must_compare(self, active: int, waiting: int | None) -> bool:
        """Return True if the banks that were read are not those shown, so that they must be compared with the
        journal."""
        shown = self._status
        return (shown.active_bank, shown.written_not_active) != (active, waiting)

    def show_reading(self, reading: ControllerReading) -> None:
        """Show what the devices said between two runs."""
        self._change(links=reading.links)
        if reading.temperatures_c:
            self._temperatures_at_s = self.now()
            self._change(temperatures_c=reading.temperatures_c)
        if reading.compared is not None:
            self.show_reconciliation(reading.compared)
        elif reading.problem or (reading.active_bank is not None and self._status.active_bank is not None):
            self.show_bank(reading.active_bank, reading.problem)

    def show_unacknowledged_end(
        self,
        state: RunState,
        run_id: str,
        kind: str,
        alarm: Alarm,
        *,
        verdict: RunVerdict,
        started: str,
        balls: int,
        touches: int,
    ) -> None:
        """Show the final state of a run that ended before the service was last started and that no reset has
        acknowledged."""
        self._change(run_id=run_id, kind=kind, alarms=(alarm,), started=started, balls=balls, touches=touches)
        self._change(verdict=verdict)
        self.enter(state, alarm.text)

    def show_left_open(self) -> None:
        """Show the alarms that arose between runs and were open when the service ended."""
        if self.kept is not None:
            self._of_comparisons = self.kept.left_open()
            self._change(alarms=(*self._status.alarms, *self._of_comparisons))

    def reset(self) -> None:
        """Return to the state idle and clear the alarms, except those that stand until the next comparison of the
        controller with the journal or until the service ends."""
        shown = self._status.alarms
        self._acknowledged = tuple(alarm for alarm in shown if alarm in self._of_comparisons)
        standing = (*self._acknowledged, *self._of_endpoints)
        self._end_alarms(tuple(alarm for alarm in shown if alarm not in standing))
        self._change(alarms=standing, fraction=0.0, minutes_left=None, step="", run_id=None, kind=None, started=None)
        self._change(source="", by="", balls=0, touches=0, verdict=None)
        self.enter(RunState.IDLE, "reset")

    def show_reconciliation(self, result: Reconciliation) -> None:
        """Show the result of a comparison of the controller with the journal, including the bank that is active in the
        controller. If a person must act, show the instruction as an alarm."""
        unfinished, former = result.unfinished, self._status.unproved
        told = () if former is None else tuple(a for a in self._status.alarms if a.text.startswith(former.situation))
        told, self._acknowledged = (*told, *self._acknowledged), ()
        self._of_comparisons = tuple(alarm for alarm in self._of_comparisons if alarm not in told)
        self._end_alarms(told)
        self._change(
            alarms=tuple(alarm for alarm in self._status.alarms if alarm not in told),
            written_not_active=result.waiting_bank,
            unproved=result.unproved,
            unfinished=unfinished.run_id if unfinished is not None and unfinished.resumable else None,
        )
        self._unexpected = result.state in _UNEXPECTED
        self.show_bank(result.active_bank)
        self.event_log.publish("note", result.text, {"found": result.state.value, "done": result.action.value})
        log.info("reconciled", text=result.text)
        if result.instruction:
            refused = f": {result.refused}" if result.refused else ""
            situation = result.state.value if result.unproved is None else result.unproved.situation
            alarm = alarm_of(StoreError(f"{situation}{refused}", hint=result.instruction))
            if alarm not in self._status.alarms:  # after each interruption of the link, the comparison is made again
                self._of_comparisons = (*self._of_comparisons, alarm)
                self.idle_alarm(alarm)

    # ------------------------------------------------------------------ a run

    def begin_run(self, run_id: str, kind: str, source: Source, position_set: str | None, by: str = "") -> None:
        """Show a run that begins now. `by` is the name of who asked for it if it is known."""
        self._end_alarms(tuple(alarm for alarm in self._status.alarms if alarm not in self._of_endpoints))
        self._of_comparisons = self._acknowledged = ()
        self._temperatures_at_s = None
        self._change(
            ve_now_um=self.status().ve_now_um,  # not that of a table which the controller had lost before
            run_id=run_id,
            kind=kind,
            position_set=position_set,
            started=utc_timestamp(),
            source=source,
            by=by,
            step="",
            fraction=0.0,
            minutes_left=None,
            phase=PREFLIGHT,
            phase_fraction=None,
            phase_minutes_left=None,
            simulated_steps=0,
            balls=0,
            touches=0,
            axis_mm=None,
            verdict=None,
            read_problem="",
            alarms=(),
        )
        self._unexpected = False
        self.enter(RunState.PREFLIGHT, f"{kind} requested by {requester_of({'source': source, BY: by})}")

    def on_announcement(self, announcement: Announcement) -> None:
        """Update the status and the event log with an announcement of the run (state, progress or note)."""
        data = announcement.data
        match announcement.kind:
            case "state":
                state = RunState(data["state"])
                if state not in AT_REST:  # the owner enters these once the machine is released
                    self._change(**_phase_in(state, self._status))
                    self.enter(state, announcement.text)
                return
            case "progress":
                self._on_progress(data)
            case _:
                log.info(announcement.text, **data)
        self.event_log.publish(announcement.kind, announcement.text, data)

    def begin_return(self) -> None:
        """Show that the machine of a resumed run returns to where the run was interrupted, before the run goes on."""
        self._change(**{**_NO_PHASE, "phase": RETURN})

    def on_step(self, step: Step, result: object) -> None:
        """Update the status after a step. The engine, which carries out the steps, calls this method at every step, so
        it must take only microseconds."""
        now = self._status
        match step:
            case TouchTowards():
                at = result.position_mm if isinstance(result, (Touch, Miss)) else step.target_mm
                self._change(step=step.key, touches=now.touches + 1, axis_mm=at)
            case MoveTo() | Retrace():
                self._change(step=step.key, axis_mm=step.target_mm)
            case Record():
                self._on_record(step)
            case ReadTemperatures():
                self.event_log.publish("temperature", step.key, _mapping(result))
            case ReadActiveBank():
                self._change(active_bank=result)
            case ActivateBank():
                self._change(active_bank=step.bank)
            case _:
                self._change(step=step.key)

    def show_question(self, question: Question | None, text: str) -> None:
        """Show an open question. If `question` is None, remove the question; `text` then states how the question
        ended."""
        self._change(question=question)
        data = {} if question is None else {"number": question.number, "station": question.station}
        self.event_log.publish("question", text, {"open": question is not None, **data})
        log.info("question", open=question is not None, text=text)

    def show_outcome(self, outcome: Outcome) -> None:
        self._change(minutes_left=None, simulated_steps=0, verdict=outcome.verdict, **_NO_PHASE)
        self.show_bank(outcome.table_bank)
        self.event_log.publish("outcome", outcome.reason or outcome.state.value, outcome.as_json())

    def alarm(self, alarm: Alarm) -> None:
        """Add an alarm to the end of the list of open alarms. The first alarm in the list states the cause of the
        others."""
        self._change(alarms=(*self._status.alarms, alarm))
        data = {"code": alarm.code, "hint": alarm.hint, "where": dict(alarm.where)}
        self.event_log.publish("alarm", alarm.text, data)
        log.error(alarm.text, **data)

    def idle_alarm(self, alarm: Alarm) -> None:
        """Add an alarm that arose between runs, and record it in the journal."""
        if ENDPOINT in alarm.where:
            self._of_endpoints = (*self._of_endpoints, alarm)
        if self.kept is not None:
            self.kept.keep(alarm)
        self.alarm(alarm)

    def _end_alarms(self, alarms: tuple[Alarm, ...]) -> None:
        if self.kept is not None:
            self.kept.end(alarms)

    def enter(self, state: RunState, text: str) -> None:
        former, verdict = self._status.state, self._status.verdict
        if verdict is None and state in AT_REST - {S.IDLE}:  # the run has ended without an outcome
            verdict = verdict_of(self._status.kind or "", state.value, ended=True, accepted=None, decision=None)
        # at rest, anybody may move the axes
        ended = {**_NO_PHASE, "simulated_steps": 0, "axis_mm": None} if state in AT_REST else {}
        self._change(state=state, packml=PACKML[state], verdict=verdict, **ended)
        run = {"run_id": self._status.run_id, "kind": self._status.kind}
        self.event_log.publish("state", text, {"state": state.value, "packml": PACKML[state], **run})
        log.info("state", state=state.value, former=former.value, text=text)

    # ------------------------------------------------------------------

    def _on_progress(self, data: Mapping[str, Any]) -> None:
        told = {name: data[name] for name in _PROGRESS if name in data}
        if self._status.state in _STILL:  # while a table is computed or written, the state is the phase
            told = {name: value for name, value in told.items() if name not in _NO_PHASE}
        self._change(**told)

    def _on_record(self, step: Record) -> None:
        if step.key.endswith("/lost"):
            self.event_log.publish("lost", step.key, step.payload)
        if step.kind != "ball":
            return
        self._change(step=step.key, balls=self._status.balls + 1)
        self.event_log.publish("ball", step.key, step.payload)

    def _change(self, **values: Any) -> None:
        with self._lock:
            changed = replace(self._status, **values)
            self._status = replace(changed, doing=_doing_now(changed))


def _mapping(result: object) -> dict[str, Any]:
    return dict(result) if isinstance(result, dict) else {}


def _resettable(alarms: tuple[Alarm, ...]) -> bool:
    """Return True if a reset may clear one of the alarms. That of an endpoint stands until the service ends, and keeps
    no run from starting."""
    return any(ENDPOINT not in alarm.where for alarm in alarms)


def _doing_now(status: Status) -> str:
    """Return the current activity as one line of text. Between runs it says if an unproved table is active; panels show
    48 characters of it."""
    if status.unproved is not None and status.state in AT_REST:
        words = "not ready" if status.state in (S.IDLE, S.WRITTEN) else _STATES[status.state].split(";")[0]
        return f"{words}: unproved table active (bank {status.unproved.bank})"
    if status.verdict is not None and status.state in AT_REST:
        return status.verdict.sentence["en"]
    if status.state is S.IDLE and (_resettable(status.alarms) or status.unfinished is not None):
        return "not ready: an alarm is open" if _resettable(status.alarms) else f"run {status.unfinished} is unfinished"
    return doing(status.state, status.step, status.kind, status.phase)


def _phase_in(state: RunState, former: Status) -> dict[str, Any]:
    """Return the phase of a run that enters `state`. While the machine moves, the steps say in which phase it is."""
    if state in (S.PREFLIGHT, S.RESUMING):
        return {**_NO_PHASE, "phase": PREFLIGHT}
    if state is S.VERIFYING and former.phase != VERIFICATION:
        return {"phase": VERIFICATION, "phase_fraction": 0.0, "phase_minutes_left": None}
    if state in _MOVING:
        return _NO_PHASE if former.phase == RETURN else {}
    return {**_NO_PHASE, "phase": state.value}


def doing(state: RunState, step: str, kind: str | None, phase: str = "") -> str:
    """Return the current activity of the service as one line of text. During a measurement the line includes the
    station, the orientation and the ball, and during the checks before the first position it names the check."""
    words = _PHASES.get(phase, _STATES[state]) if state in (S.MEASURING, S.RESUMING) else _STATES[state]
    place = _place(step) if state in _MOVING else ""
    if state is S.MEASURING and not place and kind is not None:
        return f"{words}: preparing"
    return f"{words}: {place}" if place else words


def _place(step: str) -> str:
    found = _KEY.match(step)
    if found is None or found["station"] is None:
        return ""
    parts = [f"station {found['station']}"]
    if found["az"] is not None:
        parts.append(f"azimuth {found['az']}°, elevation {found['el']}°")
    if found["ball"] is not None:
        parts.append(f"ball {int(found['ball'])}")
    return ", ".join(parts)
