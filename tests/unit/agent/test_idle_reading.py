"""What is displayed between runs was read from the controller, or is not known."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from journal_surgery import operate
from journaled import journaled
from pydantic import ValidationError
from service_house import PATIENCE_S, House, house
from structlog.testing import capture_logs

from agent.errors import Busy, JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.history.retention import compact
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.run_request import RunRequest
from agent.service.control import Alarm, LinkState
from agent.service.owner import idle_reader, machine_use
from agent.service.owner.idle_reader import idle_reading, tidy_up
from agent.service.state.controller_reading import ControllerReading, read_controller
from agent.service.state.event_log import EventLog
from agent.service.state.status_board import IdleStatus, StatusBoard
from agent.settings.service import ServiceSettings
from drivers.clock import VirtualClock
from drivers.errors import InputError, LinkLost, VolcalError
from drivers.roles import TableImage

LINKS = (LinkState("cnc"), LinkState("mount", "no answer"))


def board(clock: VirtualClock) -> StatusBoard:
    return StatusBoard("case-study", EventLog(), clock.now)


def compared(state: CompensationState, bank: int) -> Reconciliation:
    instruction = "" if state is CompensationState.AS_EXPECTED else "look at the controller"
    return Reconciliation(state, ReconcileAction.NOTHING, bank, instruction=instruction)


def test_what_was_read_is_shown_with_its_age() -> None:
    clock = VirtualClock()
    shown = board(clock)
    shown.show_idle(IdleStatus(ve_before_um=30.0, ve_now_um=10.0))
    assert (shown.status().active_bank, shown.status().read_age_s, shown.status().ve_now_um) == (None, None, None)
    expected = compared(CompensationState.AS_EXPECTED, 1)
    shown.show_reading(ControllerReading(LINKS, 1, compared=expected))
    clock.sleep(7.0)
    now = shown.status()
    assert (now.active_bank, now.read_age_s, now.ve_now_um, now.links) == (1, 7.0, 10.0, LINKS)


def test_what_cannot_be_read_is_not_known() -> None:
    clock = VirtualClock()
    shown = board(clock)
    shown.show_idle(IdleStatus(ve_before_um=30.0, ve_now_um=10.0))
    shown.show_reading(ControllerReading(LINKS, 1, compared=compared(CompensationState.AS_EXPECTED, 1)))
    clock.sleep(10.0)
    shown.show_reading(ControllerReading(LINKS, problem="connection refused"))
    now = shown.status()
    assert (now.active_bank, now.ve_now_um, now.ve_before_um) == (None, None, 30.0)
    assert (now.read_problem, now.read_age_s) == ("connection refused", 10.0)
    assert shown.must_compare(1, None)  # it may be another table by the time that it answers again
    shown.show_reading(ControllerReading(LINKS, 1, compared=compared(CompensationState.AS_EXPECTED, 1)))
    assert (shown.status().active_bank, shown.status().read_problem, shown.status().ve_now_um) == (1, "", 10.0)


def test_a_controller_that_has_lost_its_table_is_an_alarm_once_and_its_accuracy_is_not_known() -> None:
    shown = board(VirtualClock())
    shown.show_idle(IdleStatus(ve_before_um=30.0, ve_now_um=10.0))
    shown.show_reading(ControllerReading(LINKS, 1, compared=compared(CompensationState.AS_EXPECTED, 1)))
    assert shown.must_compare(0, None)
    shown.show_reading(ControllerReading(LINKS, 0, compared=compared(CompensationState.LOST, 0)))
    assert not shown.must_compare(0, None)
    shown.show_reading(ControllerReading(LINKS, 0))
    shown.show_reading(ControllerReading(LINKS, problem="no answer"))
    shown.show_reading(ControllerReading(LINKS, 0, compared=compared(CompensationState.LOST, 0)))
    now = shown.status()
    assert (now.active_bank, now.ve_now_um) == (0, None)
    shown.begin_run("20261121T020000Z-0000", "calibrate", "page", "S3")
    assert (shown.status().active_bank, shown.status().ve_now_um) == (0, None)
    assert [alarm.code for alarm in now.alarms] == [360]


def test_a_reading_is_shown_before_a_request_that_waits_for_it_is_carried_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with house(tmp_path) as built:
        built.owner.reconcile_if_reached()
        built.machine.readings.append(ControllerReading(LINKS, 2, compared=None))
        built.machine.found.extend(compared(CompensationState.AS_EXPECTED, bank) for bank in (2, 1))
        between_runs = built.owner.use.between_runs

        @contextmanager
        def settled_after(work: str) -> Iterator[bool]:
            with between_runs(work) as idle:
                yield idle
            settling = threading.Thread(target=built.owner.reset)  # it was only waiting for the end of the reading
            settling.start()
            settling.join(PATIENCE_S)

        monkeypatch.setattr(built.owner.use, "between_runs", settled_after)
        built.parts.board.idle_alarm(Alarm(1, "something"))
        built.owner.read_idle()
        assert built.owner.status().active_bank == 1


def test_the_machine_is_read_between_runs_and_never_during_one(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        built.machine.found.append(compared(CompensationState.AS_EXPECTED, 2))
        built.machine.readings.append(ControllerReading(LINKS, 2))
        built.owner.read_idle()
        assert (built.owner.status().active_bank, built.owner.status().links) == (2, LINKS)
        started(built)
        asked = list(built.machine.asked)
        built.owner.read_idle()
        assert built.machine.asked == asked
        built.puppet.end(RunState.FAULTED, LinkLost("gone"))
        assert built.owner.wait(PATIENCE_S)
        assert built.owner.status().active_bank is None


def started(built: House) -> None:
    built.owner.start(RunRequest(kind="calibrate", source="page", consent=True))
    built.puppet.begun()


class SlowMachine:
    """Reading of a machine that answers when the test lets it."""

    def __init__(self) -> None:
        self.begun, self.answer = threading.Event(), threading.Event()

    def read(self, *_: object) -> ControllerReading:
        self.begun.set()
        assert self.answer.wait(PATIENCE_S)
        return ControllerReading(LINKS, problem="late")


def test_a_run_waits_for_a_reading_in_progress_and_its_result_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with house(tmp_path) as built:
        slow = SlowMachine()
        monkeypatch.setattr(type(built.machine), "read", slow.read)
        reading = threading.Thread(target=built.owner.read_idle)
        reading.start()
        assert slow.begun.wait(PATIENCE_S)
        starting = threading.Thread(target=started, args=(built,))
        starting.start()
        while not built.owner.busy:  # the run is reserved, and waits
            built.owner.use.await_change(0.01)
        assert built.puppet.started == []
        slow.answer.set()
        reading.join(PATIENCE_S)
        starting.join(PATIENCE_S)
        assert len(built.puppet.started) == 1
        assert built.owner.status().read_problem == ""


def test_a_request_waits_for_a_device_that_hangs_only_so_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with house(tmp_path) as built:
        slow = SlowMachine()
        monkeypatch.setattr(type(built.machine), "read", slow.read)
        monkeypatch.setattr(machine_use, "READING_LIMIT_S", 0.01)
        reading = threading.Thread(target=built.owner.read_idle)
        reading.start()
        assert slow.begun.wait(PATIENCE_S)
        for ask in (lambda: started(built), built.owner.reset):
            with pytest.raises(Busy, match="has not ended after"):
                ask()
        assert not built.owner.busy
        slow.answer.set()
        reading.join(PATIENCE_S)
        started(built)
        assert len(built.puppet.started) == 1


def test_the_end_of_the_service_awaits_a_reading_in_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with house(tmp_path) as built:
        slow = SlowMachine()
        monkeypatch.setattr(type(built.machine), "read", slow.read)
        service = built.owner.settings.service.model_copy(update={"idle_read_period_s": 3600.0})
        monkeypatch.setattr(built.owner, "settings", built.owner.settings.model_copy(update={"service": service}))

        def answer_when_stopped() -> None:
            while built.owner.use.await_change(0.01):
                pass
            slow.answer.set()

        with idle_reading(built.owner):
            assert slow.begun.wait(PATIENCE_S)
            threading.Thread(target=answer_when_stopped).start()
            assert not slow.answer.is_set()
        assert slow.answer.is_set()
        assert not [thread for thread in threading.enumerate() if thread.name == "idle-reader"]


def test_the_reader_ends_with_the_service_also_between_two_readings(tmp_path: Path) -> None:
    with house(tmp_path) as built, idle_reading(built.owner):
        built.owner.close(0.0)
    assert not [thread for thread in threading.enumerate() if thread.name == "idle-reader"]


def test_the_comparison_at_the_start_of_the_service_waits_for_a_reading_in_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two connections to the controller at a time would disturb each other."""
    with house(tmp_path) as built:
        slow, waits = SlowMachine(), threading.Event()
        monkeypatch.setattr(type(built.machine), "read", slow.read)
        await_reading = built.owner.use.await_work

        def awaited() -> None:
            waits.set()
            await_reading()
            assert slow.answer.is_set()

        monkeypatch.setattr(built.owner.use, "await_work", awaited)
        reading = threading.Thread(target=built.owner.read_idle)
        reading.start()
        assert slow.begun.wait(PATIENCE_S)
        asked = list(built.machine.asked)
        comparing = threading.Thread(target=built.owner.reconcile_if_reached)
        comparing.start()
        waited = waits.wait(PATIENCE_S)
        during = list(built.machine.asked)
        slow.answer.set()
        reading.join(PATIENCE_S)
        comparing.join(PATIENCE_S)
        assert (waited, during) == (True, asked)
        assert len(built.machine.asked) == len(asked) + 1


class TestTidyingUp:
    """Between runs, old runs are compacted; a run is never written meanwhile."""

    @pytest.fixture
    def state(self, tmp_path: Path) -> Path:
        for night in range(3):
            journaled(tmp_path, night)
            add_touch(tmp_path, night + 1)
        return tmp_path

    def test_old_runs_are_compacted_when_the_service_starts_and_after_each_run(
        self, state: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        tidied: SimpleQueue[frozenset[int]] = SimpleQueue()

        def tidy_up(owner: Any) -> None:
            idle_reader_tidy_up(owner)
            tidied.put(compacted(state))

        idle_reader_tidy_up = idle_reader.tidy_up
        monkeypatch.setattr(idle_reader, "tidy_up", tidy_up)
        with house(state, history={"whole_runs": 2, "whole_days": 0.0}) as built, idle_reading(built.owner):
            assert tidied.get(timeout=PATIENCE_S) == {1}
            journaled(state, 3)
            add_touch(state, 4)
            started(built)
            built.puppet.end(RunState.COMPLETE)
            assert tidied.get(timeout=PATIENCE_S) == {1, 2}

    def test_the_end_of_a_resumed_run_is_the_end_of_a_run_too(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        tidied: SimpleQueue[str | None] = SimpleQueue()
        monkeypatch.setattr(idle_reader, "tidy_up", lambda owner: tidied.put(owner.status().started))
        with house(tmp_path) as built:
            board = built.parts.board
            with idle_reading(built.owner):
                assert tidied.get(timeout=PATIENCE_S) is None
                for started_at in ("2026-11-21T02:00:00.000Z", "2026-11-21T09:00:00.000Z"):
                    board.begin_run("20261121T020000Z-0000", "calibrate", "page", "S3")
                    board._change(started=started_at)
                    built.owner.use.release()  # wakes the thread as the end of a run does
                    while tidied.get(timeout=PATIENCE_S) != started_at:
                        pass

    def test_no_run_is_compacted_while_another_is_in_progress(self, state: Path) -> None:
        with house(state, history={"whole_runs": 1, "whole_days": 0.0}) as built:
            started(built)
            tidy_up(built.owner)
            assert compacted(state) == set()
            built.puppet.end(RunState.COMPLETE)
            assert built.owner.wait(PATIENCE_S)
            tidy_up(built.owner)
            assert compacted(state) == {1, 2}

    def test_a_requested_run_waits_for_the_run_being_compacted_and_stops_the_next(
        self, state: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        begun, go_on = threading.Event(), threading.Event()

        def slowly(*args: Any, **named: Any) -> Any:
            begun.set()
            assert go_on.wait(PATIENCE_S)
            return compact(*args, **named)

        monkeypatch.setattr(idle_reader, "compact", slowly)
        with house(state, history={"whole_runs": 1, "whole_days": 0.0}) as built:
            tidying = threading.Thread(target=tidy_up, args=(built.owner,))
            tidying.start()
            assert begun.wait(PATIENCE_S)
            starting = threading.Thread(target=started, args=(built,))
            starting.start()
            while not built.owner.busy:  # the run is reserved, and waits
                built.owner.use.await_change(0.01)
            assert built.puppet.started == []
            go_on.set()
            tidying.join(PATIENCE_S)
            starting.join(PATIENCE_S)
            assert len(built.puppet.started) == 1
            assert compacted(state) == {1}

    def test_a_journal_that_cannot_be_written_does_not_end_the_thread(
        self, state: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def full(*_: Any, **__: Any) -> None:
            raise JournalFailed("the journal cannot be compacted: database or disk is full")

        monkeypatch.setattr(idle_reader, "compact", full)
        with house(state, history={"whole_runs": 1, "whole_days": 0.0}) as built, capture_logs() as logs:
            tidy_up(built.owner)
            assert [line["event"] for line in logs if line["log_level"] == "warning"] == ["old runs not compacted"]
        assert compacted(state) == set()

    def test_a_folder_that_cannot_be_written_does_not_keep_the_later_runs_whole(
        self, state: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def first_not(directory: Path, row: RunRow, *, write: bool) -> Any:
            if row.run == 1:
                raise InputError("results cannot be written: Permission denied")
            return compact(directory, row, write=write)

        monkeypatch.setattr(idle_reader, "compact", first_not)
        with house(state, history={"whole_runs": 1, "whole_days": 0.0}) as built, capture_logs() as logs:
            tidy_up(built.owner)
        warned = [line for line in logs if line["log_level"] == "warning"]
        assert [(line["event"], line["runs"]) for line in warned] == [("old runs not compacted", 1)]
        assert compacted(state) == {2}


def add_touch(state: Path, run: int) -> None:
    operate(state, "INSERT INTO steps VALUES (?, 1, 'ball', 'TouchTowards', '{}', 1.0, 2.0, '{}', NULL, 0)", run)


def compacted(state: Path) -> frozenset[int]:
    with open_journal(state) as reader:
        return reader.compacted_runs()


@pytest.mark.parametrize("period_s", [1e-3, 0.99])
def test_a_period_in_which_the_devices_would_be_opened_all_the_time_is_refused(period_s: float) -> None:
    with pytest.raises(ValidationError, match="must be 0"):
        ServiceSettings(idle_read_period_s=period_s)
    assert ServiceSettings(idle_read_period_s=1.0).idle_read_period_s == 1.0


class Device:
    """Device of a driver that can open it only as for a run."""

    def __init__(self) -> None:
        self.log = list[str]()

    def open(self) -> None:
        self.log.append("open")

    def close(self) -> None:
        self.log.append("close")


class LookedAt(Device):
    def __init__(self, error: VolcalError | None = None, *, reason: str = "") -> None:
        super().__init__()
        self.error, self.reason = error, reason

    def why_no_look(self) -> str:
        return self.reason

    def open_to_look(self, *, tables: bool = False) -> None:
        self.log.append("look at tables" if tables else "look")
        if self.error is not None:
            raise self.error


def temperatures(**readings_c: float) -> SimpleNamespace:
    return SimpleNamespace(temperatures_c=lambda: readings_c)


def read(
    store: Any,
    *,
    compare: bool = False,
    state: Path = Path(),
    thermometer: SimpleNamespace = temperatures(),  # noqa: B008  it is never changed
    **devices: Device,
) -> ControllerReading:
    cnc = dict.fromkeys(("machine", "probe", "store", "thermometer"), "cnc")
    roles = SimpleNamespace(**cnc, operator="console")
    rig = cast(Rig, SimpleNamespace(devices=devices, store=store, thermometer=thermometer))
    settings = cast(Any, SimpleNamespace(roles=roles, state_directory=state))
    return read_controller(rig, settings, lambda *_: compare)


def test_each_device_says_for_itself_whether_it_answers() -> None:
    cnc, mount = LookedAt(), LookedAt(LinkLost("refused"))
    found = read(
        SimpleNamespace(active_bank=lambda: 2, pending_bank=lambda: None), cnc=cnc, mount=mount, console=Device()
    )
    assert found == ControllerReading((LinkState("cnc"), LinkState("mount", "refused")), 2)
    assert (cnc.log, mount.log) == (["look", "close"], ["look"])


def test_no_device_is_opened_as_for_a_run_not_even_to_compare_its_tables(tmp_path: Path) -> None:
    cnc = LookedAt()
    found = read(Store(2), cnc=cnc, compare=True, state=tmp_path)
    assert (found.active_bank, found.compared is not None) == (2, True)
    assert cnc.log == ["look", "close", "look at tables", "close"]


def test_a_device_that_cannot_be_looked_at_stays_closed_and_what_is_known_of_its_store_stays() -> None:
    cnc, mount = LookedAt(reason="it would restart"), Device()
    found = read(Store(2), cnc=cnc, mount=mount)
    assert (found.active_bank, found.problem, cnc.log, mount.log) == (None, "", [], [])
    told = [(link.device, link.ok, link.unread) for link in found.links]
    assert told == [("cnc", False, "it would restart"), ("mount", False, "its driver can open it only as for a run")]
    clock = VirtualClock()
    shown = board(clock)
    shown.show_reconciliation(compared(CompensationState.AS_EXPECTED, 2))
    clock.sleep(30.0)
    shown.show_reading(found)
    now = shown.status()
    assert (now.active_bank, now.read_age_s, now.read_problem, now.links) == (2, 30.0, "", found.links)


def test_the_thermometer_is_read_too_and_only_what_a_machine_can_have_is_a_reading() -> None:
    shown = {"column": 21.5, "open wire": float("nan"), "kelvin": 294.6}
    found = read(Store(2), cnc=LookedAt(), thermometer=temperatures(**shown))
    assert found == ControllerReading((LinkState("cnc"),), 2, temperatures_c={"column": 21.5})


def test_a_thermometer_that_does_not_answer_is_a_problem_of_its_link_alone() -> None:
    def silent() -> dict[str, float]:
        raise LinkLost("register 12: no answer")

    found = read(Store(2), cnc=LookedAt(), thermometer=SimpleNamespace(temperatures_c=silent))
    assert found == ControllerReading((LinkState("cnc", "register 12: no answer"),), 2)


def test_temperatures_are_shown_with_their_age_between_runs_only() -> None:
    clock = VirtualClock()
    shown = board(clock)
    assert (shown.status().temperatures_c, shown.status().temperatures_age_s) == ({}, None)
    shown.show_reading(ControllerReading(LINKS, 1, temperatures_c={"column": 21.5}))
    clock.sleep(4.0)
    shown.show_reading(ControllerReading(LINKS, 1))  # the thermometer did not answer
    now = shown.status()
    assert (now.temperatures_c, now.temperatures_age_s) == ({"column": 21.5}, 4.0)
    shown.begin_run("20260314T030000Z-0000", "verify", "page", None)
    shown.enter(RunState.PREFLIGHT, "")
    assert (shown.status().temperatures_c, shown.status().temperatures_age_s) == ({}, None)
    shown.enter(RunState.COMPLETE, "")
    assert shown.status().temperatures_age_s is None  # before the next reading
    shown.show_reading(ControllerReading(LINKS, 1, temperatures_c={"column": 23.0}))
    assert (shown.status().temperatures_c, shown.status().temperatures_age_s) == ({"column": 23.0}, 0.0)


def test_a_store_that_fails_in_mid_reading_leaves_nothing_known() -> None:
    def lost() -> int:
        raise LinkLost("gone")

    cnc = LookedAt()
    found = read(SimpleNamespace(active_bank=lambda: 2, pending_bank=lost), cnc=cnc)
    assert found == ControllerReading((LinkState("cnc", "gone"),), problem="gone")
    assert cnc.log == ["look", "close"]


class Store:
    """Controller with two banks, of which any may be active."""

    def __init__(self, active: int, **banks: TableImage) -> None:
        self.active, self.banks = active, {int(name[-1]): image for name, image in banks.items()}

    def active_bank(self) -> int:
        return self.active

    def pending_bank(self) -> None:
        return None

    def read_table(self, bank: int) -> TableImage | None:
        return self.banks.get(bank)


def table(value: int) -> TableImage:
    return TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.full((2, 2, 2, 3), value, dtype=np.int32))


RESTORE = "`volcal table restore 20261101T020000Z-0000 --role staged`"


@pytest.mark.parametrize(
    ("store", "state", "words"),
    [
        (Store(1, bank1=table(1)), CompensationState.AS_EXPECTED, ""),
        (Store(0, bank1=table(1)), CompensationState.LOST, "bank 1 still holds its table"),
        (Store(0), CompensationState.LOST, f"bank 1 no longer holds its table: restore it ({RESTORE})"),
        (Store(1, bank1=table(2)), CompensationState.CHANGED, f"restore the table ({RESTORE}) or calibrate again"),
        (Store(2, bank2=table(3)), CompensationState.CHANGED, f"restore the table ({RESTORE}) or calibrate again"),
        (Store(1, bank1=replace(table(1), origin_mm=(500.0, 0.0, 0.0))), CompensationState.CHANGED, "find out who"),
        (Store(1, bank1=replace(table(1), step_mm=(1.0, 2.0, 1.0))), CompensationState.CHANGED, "find out who"),
        (Store(1, bank1=replace(table(1), resolution_mm=1e-3)), CompensationState.CHANGED, "find out who"),
        (Store(2, bank1=table(1), bank2=table(3)), CompensationState.CHANGED, "find out who changed it"),
    ],
)
def test_a_power_loss_is_told_apart_from_a_change_by_a_person(
    tmp_path: Path, store: Store, state: CompensationState, words: str
) -> None:
    journal = Journal(tmp_path)
    run = journal.start_run("20261101T020000Z-0000", "calibrate", {}, "1.2.3", VirtualClock())
    run.table("backup", 0, None)
    run.table("staged", 1, table(1))
    run.decision("accepted", {})
    run.state(RunState.COMPLETE, "", final=True)
    journal.close()
    found = reconcile(cast(Rig, SimpleNamespace(store=store)), tmp_path, restore=False)
    assert (found.state, found.active_bank) == (state, store.active)
    assert words in found.instruction
    assert bool(found.instruction) is (state is not CompensationState.AS_EXPECTED)
