"""Exit paths of a run: whatever ends it, the machine is stopped and withdrawn, and the bank found is active again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.errors import Aborted, GateRefused, Interrupted, JournalFailed, MeasurementFault, PlanDiverged
from agent.execution.engine import Engine
from agent.execution.run_state import Announcement, Listener, RunStateTracker
from agent.execution.states import RunState
from agent.execution.steps import (
    ActivateBank,
    AwaitActive,
    CheckPermissions,
    Conclude,
    Enter,
    MoveTo,
    Plan,
    ReadActiveBank,
    ReadPosition,
    ReadTable,
    Record,
    ResetFault,
    RunPlan,
)
from agent.execution.supervisor import Supervisor
from agent.execution.tip_trace import LastMotion
from agent.probing.paths.retreat import Retreat
from agent.runs.guard import carry_out_guarded
from agent.runs.kinds.run_parts import found_compensation
from agent.runs.run_context import RunContext, RunHooks, run_actions
from agent.runs.run_results import BankInUse, RunResults
from drivers.clock import VirtualClock
from drivers.errors import DeadlineExpired, DeviceError, LinkLost, MotionFault, PermissionMissing, VolcalError
from drivers.roles import Activation, StoreLimits, TableImage

TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((2, 2, 2, 3), dtype=np.int32))
FOUND, NEW = 1, 2
RETREAT_Y_MM = -50.0
COURSE = Retreat(1, RETREAT_Y_MM, 0, {})
JOB: Any = SimpleNamespace(
    rules=SimpleNamespace(retreat=COURSE, probing=SimpleNamespace(stylus_axis=(0.0, 1.0, 0.0), retract_mm=10.0))
)


class FakeMachine:
    """Axes, controller and store behind the engine's actions. `failing`: steps that raise instead."""

    def __init__(self, activation: Activation = Activation.IMMEDIATE) -> None:
        self.activation = activation
        self.position = (100.0, 30.0, 200.0)
        self.active = FOUND
        self.tables: dict[int, TableImage] = {FOUND: TABLE, NEW: TABLE}
        self.stopped = self.stood_still = 0
        self.targets: list[tuple[float, float, float]] = []
        self.steps: list[str] = []
        self.failing: dict[type, Exception] = {}
        self.complaints: list[str] = []
        self.last_motion = LastMotion()
        self.store = SimpleNamespace(
            store_limits=lambda: StoreLimits((1, 2), (8, 8, 8), 512, 1e-4, 0.2, self.activation)
        )

    def actions(self, _: int) -> dict[type, Callable[[Any], Any]]:
        does: dict[type, Callable[[Any], Any]] = {
            MoveTo: self._move,
            ReadPosition: lambda _: self.position,
            CheckPermissions: lambda _: None,
            ResetFault: lambda _: None,
            ReadActiveBank: lambda _: self.active,
            ReadTable: lambda step: self.tables.get(step.bank),
            ActivateBank: self._activate,
            AwaitActive: lambda _: None,
            Record: lambda _: None,
        }
        return {kind: self._watched(kind, action) for kind, action in does.items()}

    def _watched(self, kind: type, action: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def act(step: Any) -> Any:
            self.steps.append(step.key)
            if kind in self.failing:
                raise self.failing[kind]
            return action(step)

        return act

    def _move(self, step: MoveTo) -> None:
        self.targets.append(step.target_mm)
        self.position = step.target_mm

    def _activate(self, step: ActivateBank) -> None:
        self.active = step.bank

    def stop(self) -> list[str]:
        self.stopped += 1
        return self.complaints

    def await_standstill(self) -> None:
        self.stood_still += 1
        if DeadlineExpired in self.failing:
            raise self.failing[DeadlineExpired]


class FakeJournal:
    """Journal that stores states, decisions and tables. `full`: the disk is full."""

    run = 1

    def __init__(self) -> None:
        self.full = False
        self.states: list[tuple[RunState, str]] = []
        self.decisions: list[str] = []
        self.faults: list[str] = []
        self.tables: list[tuple[str, int]] = []
        self.images: list[TableImage | None] = []

    def _write(self) -> None:
        if self.full:
            raise JournalFailed("the journal cannot be written: no space left")

    def aside(self) -> FakeJournal:
        return self

    def begin(self, _: object) -> None:
        self._write()

    def finish(self, _: object, __: object, *, begun: bool) -> None:
        self._write()

    def fail(self, _: object, __: BaseException) -> None:
        self._write()

    def fault(self, error: BaseException, step: str = "") -> None:
        self._write()
        self.faults.append(type(error).__name__)

    def state(self, state: RunState, reason: str = "", *, final: bool = False) -> None:
        self._write()
        self.states.append((state, reason))

    def decision(self, kind: str, _: object) -> None:
        self._write()
        self.decisions.append(kind)

    def table(self, role: str, bank: int, image: TableImage | None) -> None:
        self._write()
        self.tables.append((role, bank))
        self.images.append(image)


class Run:
    """Run whose plan reads the active compensation, then goes on with the plan `rest` of the test."""

    def __init__(
        self,
        machine: FakeMachine,
        journal: FakeJournal,
        rest: Callable[[Run], Plan[None]],
        listener: Listener = lambda _: None,
    ) -> None:
        rig: Any = machine
        recorder: Any = journal
        clock, hooks = VirtualClock(), RunHooks()
        self.supervisor, self.results = Supervisor(clock), RunResults()
        tracker = RunStateTracker(recorder, listener)
        actions = run_actions(rig, recorder, tracker, self.supervisor, hooks)
        engine = Engine(actions, journal, self.results.observe)
        self._context = RunContext(rig, engine, recorder, tracker, self.supervisor, clock, hooks)
        self._rest = rest
        tracker.enter(RunState.PREFLIGHT)

    def carry_out(self) -> None:
        carry_out_guarded(self._plan(), JOB, self._context, self.results)

    def _plan(self) -> RunPlan:
        yield from found_compensation()
        yield from self._rest(self)
        return None


def nothing_more(_: Run) -> Plan[None]:
    yield from ()


def written() -> Plan[None]:
    """Activate a new table, as the plan of a calibration does."""
    for state in (RunState.IDENTIFYING, RunState.STAGING, RunState.ACTIVATING):
        yield Enter(f"state/{state.value}", state)
    yield Conclude("publish/bank", lambda: BankInUse(NEW))
    yield ActivateBank("activate/activate", NEW)


def raising(error: BaseException, *, written_before: bool = False, in_step: bool = True) -> Callable[[Run], Plan[None]]:
    """Return a plan in which a step raises `error`, or which raises it itself."""

    def fail() -> None:
        raise error

    def rest(_: Run) -> Plan[None]:
        if written_before:
            yield from written()
        if in_step:
            yield Conclude("fails", fail)
        fail()

    return rest


def ended(
    rest: Callable[[Run], Plan[None]], machine: FakeMachine | None = None, journal: FakeJournal | None = None
) -> tuple[Run, FakeMachine, FakeJournal]:
    machine, journal = machine or FakeMachine(), journal or FakeJournal()
    run = Run(machine, journal, rest)
    run.carry_out()
    return run, machine, journal


def test_a_run_that_ends_well_is_left_alone() -> None:
    run, machine, journal = ended(nothing_more)
    assert run.results.error is None
    assert run.results.found is not None
    assert (run.results.found.bank, run.results.active_bank) == (FOUND, FOUND)
    assert machine.stopped == 0
    assert journal.tables == [("backup", FOUND)]


@pytest.mark.parametrize("in_step", [True, False])
def test_a_refusal_of_a_gate_is_not_a_fault(in_step: bool) -> None:
    refusal = GateRefused("no table was written: gate fit")
    run, machine, journal = ended(raising(refusal, in_step=in_step))
    assert run.results.error is refusal
    assert journal.decisions == ["refused"]
    assert journal.states[-1] == (RunState.REFUSED, str(refusal))
    assert machine.stopped == 0


@pytest.mark.parametrize("in_step", [True, False])
@pytest.mark.parametrize(
    ("error", "state"),
    [
        (Aborted("aborted: panel"), RunState.ABORTED),
        (Interrupted("interrupted: SIGTERM"), RunState.FAULTED),
        (MeasurementFault("ball 3 was not found"), RunState.FAULTED),
        (MotionFault("following error"), RunState.FAULTED),
    ],
)
def test_the_machine_is_stopped_withdrawn_and_restored(error: VolcalError, state: RunState, in_step: bool) -> None:
    run, machine, journal = ended(raising(error, written_before=True, in_step=in_step))
    assert run.results.error is error
    assert (machine.stopped, machine.stood_still) == (1, 1)
    # 10 mm back along the stylus (+Y) from y = 30, then to the retreat plane at y = -50.
    assert machine.targets == [(100.0, 20.0, 200.0), (100.0, RETREAT_Y_MM, 200.0)]
    assert machine.active == run.results.active_bank == FOUND
    assert journal.tables == [("backup", FOUND), ("restored", FOUND)]
    assert [one for one, _ in journal.states[-2:]] == [RunState.ABORTING, state]
    assert str(error) in journal.states[-1][1]
    assert run.results.end_reason == journal.states[-1][1]


def test_the_fault_of_the_controller_is_cleared_before_the_bank_is_activated() -> None:
    _, machine, _ = ended(raising(MotionFault("limit switch"), written_before=True))
    assert machine.steps.index("restore/reset") < machine.steps.index("restore/activate")


def test_a_bank_whose_activation_fails_may_be_active_and_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = FakeMachine()
    activate = machine._activate

    def activate_and_fail(step: ActivateBank) -> None:
        activate(step)
        if step.bank == NEW:
            raise DeviceError("no answer")

    monkeypatch.setattr(machine, "_activate", activate_and_fail)
    run, _, journal = ended(lambda _: written(), machine)
    assert isinstance(run.results.error, DeviceError)
    assert machine.active == run.results.active_bank == FOUND
    assert journal.tables == [("backup", FOUND), ("restored", FOUND)]


def test_without_a_written_table_no_bank_is_touched() -> None:
    _, machine, journal = ended(raising(MeasurementFault("drift")))
    assert not any(key.startswith("restore/") for key in machine.steps)
    assert journal.tables == [("backup", FOUND)]


@pytest.mark.parametrize("error", [LinkLost("connection reset"), PlanDiverged("step 5 differs")])
def test_nothing_moves_without_a_link_or_with_a_plan_that_diverged(error: VolcalError) -> None:
    _, machine, journal = ended(raising(error, written_before=True))
    assert machine.targets == []
    assert machine.stopped == 1
    assert machine.active == FOUND
    assert journal.states[-1][0] is RunState.FAULTED


def test_the_exit_path_is_not_interrupted_by_another_abort() -> None:
    def rest(run: Run) -> Plan[None]:
        yield from written()
        run.supervisor.request_abort("panel")
        yield Conclude("next", run.supervisor.check)

    run, machine, journal = ended(rest)
    run.supervisor.check()  # the request still stands, but the run is shielded
    assert isinstance(run.results.error, Aborted)
    assert machine.active == FOUND
    assert journal.states[-1][0] is RunState.ABORTED


def test_the_bank_is_restored_although_the_probe_cannot_be_withdrawn() -> None:
    machine = FakeMachine()
    machine.failing[CheckPermissions] = PermissionMissing("doors open")
    machine.complaints = ["axis drive: no answer"]
    _, _, journal = ended(raising(Aborted("aborted: page"), written_before=True), machine)
    assert machine.targets == []
    assert machine.active == FOUND
    state, reason = journal.states[-1]
    assert state is RunState.ABORTED
    beginning = "aborted: page (step fails); axis drive: no answer; could not withdraw the probe: doors open"
    assert reason.startswith(beginning)


def test_axes_that_do_not_stand_still_are_reported() -> None:
    machine = FakeMachine()
    machine.failing[DeadlineExpired] = DeadlineExpired("standstill after a stop")
    _, _, journal = ended(raising(MotionFault("following error"), written_before=True), machine)
    assert "could not bring the axes to a standstill: standstill after a stop" in journal.states[-1][1]
    assert machine.active == FOUND


def test_an_abort_that_leaves_the_table_active_is_a_fault_that_names_the_bank() -> None:
    machine = FakeMachine()

    def rest(_: Run) -> Plan[None]:
        yield from written()
        machine.failing[ActivateBank] = DeviceError("bank 1 is locked")
        raise Aborted("aborted: panel")

    run, _, journal = ended(rest, machine)
    assert machine.active == run.results.active_bank == NEW
    state, reason = journal.states[-1]
    assert state is RunState.FAULTED
    assert "bank 1 could not be made active again: bank 1 is locked" in reason


@pytest.mark.parametrize(
    ("activation", "between"),
    [
        (Activation.IMMEDIATE, []),
        (Activation.RESET, ["restore/reset-to-take-effect", "restore/takes-effect"]),
        (Activation.POWER_CYCLE, ["restore/takes-effect"]),
    ],
)
def test_a_restored_bank_is_awaited_until_the_controller_activates_it(
    activation: Activation, between: list[str]
) -> None:
    _, machine, _ = ended(raising(MotionFault("limit"), written_before=True), FakeMachine(activation))
    first = machine.steps.index("restore/activate")
    expected = ["restore/activate", *between, "restore/active-bank", "restore/activated", "restore/active-table"]
    assert machine.steps[first:] == expected


def test_with_a_full_disk_the_probe_is_withdrawn_and_the_bank_restored() -> None:
    journal = FakeJournal()

    def rest(_: Run) -> Plan[None]:
        yield from written()
        journal.full = True
        yield MoveTo("next", (0.0, 0.0, 0.0))

    run, machine, _ = ended(rest, journal=journal)
    assert isinstance(run.results.error, JournalFailed)
    assert machine.position == (100.0, RETREAT_Y_MM, 200.0)
    assert machine.active == run.results.active_bank == FOUND
    assert journal.tables == [("backup", FOUND)]


def test_the_bank_is_restored_although_the_disk_fills_on_the_exit_path(monkeypatch: pytest.MonkeyPatch) -> None:
    journal = FakeJournal()
    machine = FakeMachine()
    does = machine.stop

    def stop() -> list[str]:
        journal.full = True
        return does()

    monkeypatch.setattr(machine, "stop", stop)
    run, _, _ = ended(raising(MotionFault("limit"), written_before=True), machine, journal)
    assert machine.active == run.results.active_bank == FOUND


def test_a_full_disk_is_recorded_as_the_fault_as_soon_as_there_is_room_again(monkeypatch: pytest.MonkeyPatch) -> None:
    journal, machine = FakeJournal(), FakeMachine()
    does = machine.stop

    def stop() -> list[str]:
        journal.full = False
        return does()

    monkeypatch.setattr(machine, "stop", stop)

    def fill(_: Run) -> Plan[None]:
        yield from written()
        journal.full = True
        yield MoveTo("next", (0.0, 0.0, 0.0))

    run, _, _ = ended(fill, machine, journal)
    assert isinstance(run.results.error, JournalFailed)
    assert journal.faults == ["JournalFailed"]
    assert journal.states[-1][0] is RunState.FAULTED


@pytest.mark.parametrize("in_step", [True, False])
def test_a_defect_is_raised_after_the_machine_is_as_it_was_found(in_step: bool) -> None:
    machine, journal = FakeMachine(), FakeJournal()
    defect = ZeroDivisionError("division by zero")
    run = Run(machine, journal, raising(defect, written_before=True, in_step=in_step))
    with pytest.raises(ZeroDivisionError):
        run.carry_out()
    assert machine.active == FOUND
    assert machine.position[1] == RETREAT_Y_MM
    state, reason = journal.states[-1]
    assert state is RunState.FAULTED
    assert reason.startswith("internal error of the program")
    assert "Zero" not in reason


class GoneDisplay:
    """Display whose terminal, or the reader of whose pipe, is gone after the new table has been activated."""

    def __init__(self, error: BaseException) -> None:
        self.error: BaseException | None = None
        self.asked: list[str] = []
        self._error = error

    def break_off(self) -> None:
        self.error = self._error

    def __call__(self, announcement: Announcement) -> None:
        self.asked.append(announcement.text)
        if self.error is not None:
            raise self.error


GONE = [SystemExit(1), OSError(5, "Input/output error"), BrokenPipeError(32, "Broken pipe"), KeyError("phase")]


@pytest.mark.parametrize("gone", GONE)
@pytest.mark.parametrize("error", [Aborted("aborted: SIGINT"), GateRefused("no table was written: gate fit")])
def test_a_run_ends_the_same_without_its_display(error: VolcalError, gone: BaseException) -> None:
    machine, journal, display = FakeMachine(), FakeJournal(), GoneDisplay(gone)

    def rest(_: Run) -> Plan[None]:
        if isinstance(error, Aborted):
            yield from written()
        display.break_off()
        yield Conclude("fails", raising_now(error))

    run = Run(machine, journal, rest, display)
    run.carry_out()
    assert run.results.error is error
    assert machine.active == FOUND
    if isinstance(error, Aborted):
        assert (machine.stopped, machine.position[1]) == (1, RETREAT_Y_MM)
        assert journal.tables == [("backup", FOUND), ("restored", FOUND)]
        assert [state for state, _ in journal.states[-2:]] == [RunState.ABORTING, RunState.ABORTED]
    else:
        assert journal.states[-1][0] is RunState.REFUSED


def raising_now(error: BaseException) -> Callable[[], None]:
    def fail() -> None:
        raise error

    return fail


@pytest.mark.parametrize("gone", GONE)
def test_a_display_that_fails_once_does_not_end_the_run_and_is_told_what_follows(gone: BaseException) -> None:
    display: Any = GoneDisplay(gone)
    recorder: Any = FakeJournal()
    recorder.event = lambda _, record: recorder.decisions.append(record["text"])
    tracker = RunStateTracker(recorder, display)
    display.break_off()
    tracker.enter(RunState.PREFLIGHT)
    tracker.note("preflight passed")
    tracker.announce_note("question answered")
    tracker.progress("ball 1", fraction=0.5)
    assert tracker.state is RunState.PREFLIGHT
    assert (recorder.states, recorder.decisions) == ([(RunState.PREFLIGHT, "")], ["preflight passed"])
    assert display.asked == ["preflight", "preflight passed", "question answered", "ball 1"]


def test_the_end_of_the_process_of_a_run_is_not_the_error_of_a_display() -> None:
    display = GoneDisplay(KeyboardInterrupt())
    recorder: Any = FakeJournal()
    tracker = RunStateTracker(recorder, display)
    display.break_off()
    with pytest.raises(KeyboardInterrupt):
        tracker.enter(RunState.PREFLIGHT)


@pytest.mark.parametrize("cause", [MotionFault("limit"), Aborted("aborted: panel"), KeyError("another defect")])
@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("record", "could not record the state: internal error of the program"),
        ("stop", "could not stop the devices: internal error of the program"),
        ("standstill", "could not bring the axes to a standstill: internal error of the program"),
        ("withdraw", "could not withdraw the probe: internal error of the program"),
        ("restore", "bank 1 could not be made active again: internal error of the program"),
    ],
)
def test_a_defect_on_the_exit_path_does_not_keep_the_rest_of_it_from_being_done(
    place: str, said: str, cause: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, journal = FakeMachine(), FakeJournal()
    defect = ZeroDivisionError("division by zero")

    def rest(_: Run) -> Plan[None]:
        yield from written()
        match place:
            case "record":
                monkeypatch.setattr(journal, "state", once(raising_now(defect), journal.state))
            case "stop":
                monkeypatch.setattr(machine, "stop", raising_now(defect))
            case "standstill":
                machine.failing[DeadlineExpired] = defect
            case "withdraw":
                machine.failing[CheckPermissions] = defect
            case "restore":
                machine.failing[ActivateBank] = defect
        raise cause

    run = Run(machine, journal, rest)
    with pytest.raises(type(cause) if isinstance(cause, KeyError) else ZeroDivisionError) as raised:
        run.carry_out()
    if isinstance(cause, KeyError):
        assert "ZeroDivisionError: division by zero" in "".join(raised.value.__notes__)
    assert machine.stopped == (0 if place == "stop" else 1)
    assert machine.stood_still == 1
    assert machine.targets == ([] if place == "withdraw" else [(100.0, 20.0, 200.0), (100.0, RETREAT_Y_MM, 200.0)])
    assert machine.active == run.results.active_bank == (NEW if place == "restore" else FOUND)
    state, reason = journal.states[-1]
    assert state is RunState.FAULTED
    assert said in reason
    assert "Zero" not in reason


def once(first: Callable[[], None], then: Callable[..., None]) -> Callable[..., None]:
    """Return a function that calls `first` at its first call and `then` at all others."""
    calls: list[None] = []

    def act(*args: Any, **named: Any) -> None:
        calls.append(None)
        if len(calls) == 1:
            first()
        else:
            then(*args, **named)

    return act


OTHER = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.ones((2, 2, 2, 3), dtype=np.int32))


@pytest.mark.parametrize("held", [OTHER, replace(TABLE, origin_mm=(500.0, 0.0, 0.0)), None])
@pytest.mark.parametrize("full", [False, True])
def test_a_former_bank_that_was_written_during_the_run_is_told_and_not_called_restored(
    held: TableImage | None, full: bool
) -> None:
    machine, journal = FakeMachine(), FakeJournal()

    def rest(_: Run) -> Plan[None]:
        yield from written()
        machine.tables = {NEW: TABLE} if held is None else {FOUND: held, NEW: TABLE}
        journal.full = full
        raise Aborted("aborted: panel")

    run, _, _ = ended(rest, machine, journal)
    assert machine.active == run.results.active_bank == FOUND
    assert "bank 1 holds another table than before the run" in run.results.end_reason
    if not full:
        assert journal.states[-1] == (RunState.FAULTED, run.results.end_reason)
        assert (journal.tables[-1], journal.images[-1]) == (("restored", FOUND), held)


def test_a_former_bank_that_is_active_but_cannot_be_read_is_told() -> None:
    machine, journal = FakeMachine(), FakeJournal()

    def rest(_: Run) -> Plan[None]:
        yield from written()
        machine.failing[ReadTable] = DeviceError("no answer")
        raise Aborted("aborted: panel")

    run, _, _ = ended(rest, machine, journal)
    assert machine.active == run.results.active_bank == FOUND
    assert journal.tables == [("backup", FOUND)]
    state, reason = journal.states[-1]
    assert state is RunState.FAULTED
    assert "bank 1 is active again, but its table could not be read: no answer" in reason
