"""Return of a resumed run: the bank that was active, and the tip, before the first step that needs them."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.errors import PlanDiverged, PlanRefused
from agent.execution.encoding import table_digest
from agent.execution.engine import Engine
from agent.execution.steps import (
    ActivateBank,
    AwaitActive,
    CheckPermissions,
    CheckProbe,
    Decide,
    MoveTo,
    Plan,
    ReadActiveBank,
    ReadPosition,
    ReadTable,
    Record,
    ResetFault,
    Retrace,
    StageTable,
    Step,
    TouchTowards,
)
from agent.execution.tip_trace import LastMotion
from agent.probing.paths.retreat import Retreat
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.return_to_position import ReturnToPosition, reactivation
from agent.runs.resume.step_trace import StepTrace
from agent.runs.run_context import RunHooks
from agent.runs.run_results import RunResults
from drivers.clock import VirtualClock
from drivers.roles import Activation, MachineStatus, MotionState, TableImage


def image(value: int) -> TableImage:
    return TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.full((2, 2, 2, 3), value, dtype=np.int32))


OLD, NEW, FOREIGN = image(1), image(2), image(3)
MOVE = MoveTo("station-1/next", (5.0, 6.0, 7.0))


class Store:
    """Banks of a controller; the key of every requested step is recorded."""

    def __init__(self, active: int, banks: Mapping[int, TableImage | None], *, garbles: bool = False) -> None:
        self.active, self.banks, self.garbles = active, dict(banks), garbles
        self.keys: list[str] = []

    def run(self, plan: Plan[bool]) -> bool:
        result: Any = None
        try:
            while True:
                step = plan.send(result)
                self.keys.append(step.key)
                result = self._do(step)
        except StopIteration as stop:
            return bool(stop.value)

    def _do(self, step: Step) -> Any:
        match step:
            case ReadActiveBank():
                return self.active
            case ReadTable(_, bank):
                return self.banks[bank]
            case StageTable(_, bank, table):
                self.banks[bank] = FOREIGN if self.garbles else table
            case ActivateBank(_, bank):
                self.active = bank
            case ResetFault() | AwaitActive() | Record():
                pass
            case _:
                raise AssertionError(f"no step of a store: {step}")
        return None


def trace(*, active: int | None, contents: Mapping[int, TableImage], staged: StageTable | None = None) -> StepTrace:
    digests: dict[int, int | None] = {bank: table_digest(table) for bank, table in contents.items()}
    return StepTrace(active_bank=active, contents=digests, staged=staged)


STAGED = StageTable("publish/stage", 2, NEW)
MEASURING = trace(active=1, contents={1: OLD})
WRITTEN = trace(active=1, contents={1: OLD, 2: NEW}, staged=STAGED)
ACTIVATED = trace(active=2, contents={1: OLD, 2: NEW}, staged=STAGED)


def after(store: Store, before: StepTrace, following: Step, activation: Activation = Activation.IMMEDIATE) -> bool:
    return store.run(reactivation("resume-1", before, following, activation))


class TestReactivation:
    def test_a_run_that_had_not_asked_for_the_bank_yet_changes_nothing(self) -> None:
        store = Store(1, {1: OLD})
        assert not after(store, trace(active=None, contents={}), MOVE)
        assert store.keys == []

    def test_the_bank_that_is_still_active_is_read_and_left(self) -> None:
        store = Store(1, {1: OLD, 2: None})
        assert not after(store, MEASURING, MOVE)
        assert store.keys == ["resume-1/active-bank", "resume-1/table"]

    def test_the_bank_that_was_active_is_activated_again(self) -> None:
        store = Store(0, {1: OLD, 2: None})
        assert not after(store, MEASURING, MOVE)
        assert store.active == 1
        assert store.keys[-3:] == ["resume-1/activate", "resume-1/active-bank", "resume-1/activated"]

    def test_no_compensation_is_activated_again_without_reading_a_table(self) -> None:
        store = Store(2, {2: OLD})
        after(store, trace(active=0, contents={}), MOVE)
        assert store.active == 0
        assert "resume-1/table" not in store.keys

    @pytest.mark.parametrize("held", [FOREIGN, None])
    def test_a_bank_that_was_written_since_is_not_activated(self, held: TableImage | None) -> None:
        store = Store(0, {1: held})
        with pytest.raises(PlanDiverged, match="does not hold the table any more") as caught:
            after(store, MEASURING, MOVE)
        assert caught.value.where["bank"] == "1"
        assert store.active == 0

    def test_a_staged_table_that_was_lost_is_written_again(self) -> None:
        store = Store(1, {1: OLD, 2: None})
        assert not after(store, WRITTEN, ActivateBank("publish/activate", 2))
        assert store.banks[2] is NEW
        assert store.active == 1

    def test_a_staged_table_that_is_there_is_not_written_again(self) -> None:
        store = Store(2, {1: OLD, 2: NEW})
        after(store, ACTIVATED, MOVE)
        assert "resume-1/stage" not in store.keys

    def test_an_active_bank_is_never_written(self) -> None:
        store = Store(2, {1: OLD, 2: FOREIGN})
        with pytest.raises(PlanDiverged, match="is active and does not hold"):
            after(store, ACTIVATED, MOVE)
        assert store.banks[2] is FOREIGN

    def test_a_bank_that_reads_back_differently_is_refused(self) -> None:
        store = Store(1, {1: OLD, 2: None}, garbles=True)
        with pytest.raises(PlanDiverged, match="reads back differently"):
            after(store, WRITTEN, ActivateBank("publish/activate", 2))
        assert store.active == 1

    def test_a_bank_that_the_next_step_writes_is_left_to_it(self) -> None:
        store = Store(1, {1: OLD, 2: FOREIGN})
        after(store, WRITTEN, STAGED)
        assert store.banks[2] is FOREIGN

    def test_an_interrupted_activation_that_took_effect_is_not_repeated(self) -> None:
        store = Store(2, {1: OLD, 2: NEW})
        assert after(store, WRITTEN, ActivateBank("publish/activate", 2))
        assert store.active == 2
        assert "resume-1/activate" not in store.keys

    def test_waiting_for_a_bank_to_take_effect_is_left_to_the_run(self) -> None:
        store = Store(1, {1: OLD, 2: NEW})
        assert not after(store, ACTIVATED, AwaitActive("publish/takes-effect", 2))
        assert store.keys == []

    def test_a_controller_that_needs_a_reset_gets_one(self) -> None:
        store = Store(0, {1: OLD})
        after(store, MEASURING, MOVE, Activation.RESET)
        activated = store.keys[store.keys.index("resume-1/activate") :]
        assert activated[1:3] == ["resume-1/reset-to-take-effect", "resume-1/takes-effect"]


class Machine:
    """Rig with axes only. `log`: stops, waits and steps in their order."""

    def __init__(self, at: tuple[float, float, float]) -> None:
        self.at = at
        self.log: list[str] = []
        self.targets: list[tuple[float, float, float]] = []
        self.complaints: list[str] = []
        self.last_motion = LastMotion()
        self.machine = self

    def status(self) -> MachineStatus:
        return MachineStatus(MotionState.IDLE, {})

    def stop(self) -> list[str]:
        self.log.append("stop")
        return self.complaints

    def await_standstill(self) -> None:
        self.log.append("standstill")

    def engine(self, store: Store) -> Engine:
        def move(step: MoveTo | Retrace) -> None:
            self.log.append(step.key)
            self.targets.append(step.target_mm)
            self.at = step.target_mm

        def of_the_store(step: Step) -> Any:
            self.log.append(step.key)
            return store._do(step)

        kinds = (ReadActiveBank, ReadTable, StageTable, ActivateBank, AwaitActive, ResetFault, Record)
        return Engine(
            {
                MoveTo: move,
                Retrace: move,
                ReadPosition: lambda _: self.at,
                CheckPermissions: lambda _: None,
                CheckProbe: lambda _: None,
                **dict.fromkeys(kinds, of_the_store),
            }
        )


class Tracker:
    def __init__(self) -> None:
        self.notes: list[str] = []
        self.announced = 0

    def note(self, text: str) -> None:
        self.notes.append(text)

    def announce_again(self) -> None:
        self.announced += 1


RULES = SimpleNamespace(
    retreat=Retreat(1, -50.0, 0, {}),
    probing=SimpleNamespace(stylus_axis=(0.0, 1.0, 0.0), retract_mm=10.0),
    drift=SimpleNamespace(limit_mm=0.02),
    placement=None,
)


class Return:
    """Return with everything that it uses. The run had moved to (10, 40, 20) and then to (110, 40, 20). It began at
    40 s, its last step ended at 100 s, and it goes on at 160 s."""

    def __init__(
        self,
        store: Store | None = None,
        refusal: PlanRefused | None = None,
        activation: Activation = Activation.IMMEDIATE,
    ) -> None:
        self.machine, self.tracker = Machine((90.0, 40.0, 20.0)), Tracker()
        self.clock = ResumedClock(VirtualClock(), 100.0)
        trace = StepTrace(active_bank=1)
        trace.add(ReadPosition("here"), (0.0, 0.0, 0.0))
        trace.add(MoveTo("one", (10.0, 40.0, 20.0)), None)
        trace.add(MoveTo("two", (110.0, 40.0, 20.0)), None)
        self.trace = trace
        self.asked: list[tuple[Step, float]] = []

        def too_late(following: Step, passed_minutes: float) -> PlanRefused | None:
            self.asked.append((following, passed_minutes))
            return refusal

        start = SimpleNamespace(store=SimpleNamespace(activation=activation))
        planned: Any = SimpleNamespace(job=SimpleNamespace(rules=RULES), start=start, too_late=too_late)
        self.results = RunResults()
        engine = self.machine.engine(store or Store(1, {1: OLD}))
        self.moved_when_told: list[int] = []
        hooks = RunHooks(return_begins=lambda: self.moved_when_told.append(len(self.machine.targets)))
        context: Any = SimpleNamespace(rig=self.machine, tracker=self.tracker, engine=engine, journal=None, hooks=hooks)
        self.returning = ReturnToPosition(
            "resume-1", planned, self.results, context, trace, self.clock, begun_s=40.0, time_s=160.0
        )


def test_the_tip_is_withdrawn_and_brought_to_where_the_next_step_began() -> None:
    one = Return()
    assert not one.returning.before(MOVE)
    targets = one.machine.targets
    # The interrupted move began at x = 110: 3 mm back towards it, 10 mm along the stylus, then to the retreat plane.
    assert targets[:3] == [(93.0, 40.0, 20.0), (93.0, 30.0, 20.0), (93.0, -50.0, 20.0)]
    assert one.machine.at == (110.0, 40.0, 20.0)
    # Across at the retreat plane: nothing but Y moves once the tip has left the plane.
    inside = [target for target in targets[3:] if target[1] > -50.0]
    assert {(x, z) for x, _, z in inside} == {(110.0, 20.0)}
    assert one.returning.complete
    assert one.tracker.announced == 1
    assert one.moved_when_told == [0], "told once, before the first motion"


def test_each_axis_arrives_from_the_side_from_which_it_had_come() -> None:
    one = Return()
    one.returning.before(MOVE)
    xs = [target[0] for target in one.machine.targets[3:]]
    # X had moved by +100 mm to 110, so it is approached from below by twice the 1 mm that takes up any play.
    assert min(xs) == 108.0
    assert xs[-1] == 110.0


def test_what_may_still_move_is_stopped_before_anything_else() -> None:
    one = Return()
    one.machine.complaints = ["mount: no answer"]
    one.returning.before(MOVE)
    first_motion = next(i for i, key in enumerate(one.machine.log) if key.startswith("recover/"))
    assert one.machine.log.index("stop") < one.machine.log.index("standstill") < first_motion
    assert one.tracker.notes == ["stopping what may still move: mount: no answer"]


def test_the_compensation_comes_first_and_only_once() -> None:
    store = Store(0, {1: OLD})
    one = Return(store)
    one.returning.before(ReadTable("publish/read-back", 2))
    assert store.active == 1
    assert one.machine.targets == []
    assert not one.returning.complete
    log = list(one.machine.log)
    one.returning.before(MOVE)
    assert one.machine.log[len(log)] == "stop"
    assert one.returning.complete


def test_nothing_moves_if_it_is_too_late() -> None:
    refusal = PlanRefused("the night cannot be resumed")
    one = Return(refusal=refusal)
    with pytest.raises(PlanRefused) as caught:
        one.returning.before(MOVE)
    assert caught.value is refusal
    assert one.machine.targets == []


def test_the_time_of_the_interruption_counts() -> None:
    one = Return()
    one.returning.before(MOVE)
    # From 40 s, where the run began, to 160 s, where it goes on.
    assert one.asked == [(MOVE, 2.0)]


def test_the_compensation_is_activated_in_the_way_of_the_controller() -> None:
    one = Return(Store(0, {1: OLD}), activation=Activation.RESET)
    one.returning.before(MOVE)
    assert "resume-1/compensation/reset-to-take-effect" in one.machine.log


def test_a_decision_needs_the_compensation_and_no_motion() -> None:
    store = Store(0, {1: OLD})
    one = Return(store)
    one.returning.before(Decide("prove/verdict", ("accepted", "restored"), lambda: "accepted"))
    assert store.active == 1
    assert one.machine.targets == []
    assert not one.returning.complete


def test_the_tip_is_withdrawn_by_the_rules_of_the_qualified_stylus() -> None:
    one = Return()
    probing = SimpleNamespace(stylus_axis=(0.0, 1.0, 0.0), retract_mm=7.0)
    prepared: Any = SimpleNamespace(rules=SimpleNamespace(**{**vars(RULES), "probing": probing}))
    one.results.prepared = prepared
    one.returning.before(MOVE)
    assert one.machine.targets[1] == (93.0, 33.0, 20.0)


def test_machine_time_continues_no_earlier_than_the_run_was_interrupted() -> None:
    one = Return()
    assert one.clock.now() == 100.0
    one.returning.before(MOVE)
    assert one.clock.now() == 160.0


def test_an_activation_that_took_effect_is_reported_to_the_replay() -> None:
    one = Return(Store(2, {1: OLD, 2: NEW}))
    assert one.returning.before(ActivateBank("publish/activate", 2))
    assert one.machine.targets == []


def test_an_interrupted_touch_is_left_along_its_own_direction() -> None:
    one = Return()
    # The touch began at (110, 40, 20) towards +X; the tip stands 4 mm into it.
    one.machine.at = (114.0, 40.0, 20.0)
    one.returning.before(TouchTowards("station-1/touch", (130.0, 40.0, 20.0), 5.0))
    assert one.machine.targets[0] == (110.0, 40.0, 20.0)
    assert one.machine.at == (110.0, 40.0, 20.0)
