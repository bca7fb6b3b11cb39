"""Runs that are aborted, or whose device fails, at many points: always a stated end, and the table as it was."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nights import Night, short_document
from stored_run import stored_run
from test_whole_run import WrongSign

from agent.errors import Aborted, JournalFailed, PlanRefused
from agent.execution.encoding import table_digest
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.execution.steps import ActivateBank, Step, TouchTowards
from agent.execution.supervisor import Supervisor
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.session import carry_out
from agent.settings.schema import Settings
from drivers.errors import CommandRejected, LinkLost, ReadBackMismatch
from drivers.roles import TableImage

FORMER = TableImage((0.0, 0.0, 0.0), (2000.0, 650.0, 750.0), 1e-4, np.full((3, 3, 3, 3), 7, dtype=np.int32))
"""A constant correction: what acted before must act afterwards, and it is not bank 0."""

# Counted over the whole run: 64 touches prepare the probe, the set has 245, the proof another 60.
PLACES = [
    ("position", 2),
    ("active_bank", 1),
    ("read_table", 1),
    ("probe_status", 1),
    ("move_to", 1),
    ("orient_to", 1),
    ("temperatures_c", 1),
    ("touch_towards", 1),
    ("touch_towards", 30),
    ("orient_to", 2),
    ("touch_towards", 130),
    ("move_to", 600),
    ("stage", 1),
    ("read_table", 2),
    ("activate", 1),
    ("active_bank", 2),
    ("orient_to", 6),
    ("touch_towards", 325),
    ("touch_towards", 360),
]
FEW = [place for place in PLACES if place[0] in ("position", "stage", "activate") or place[1] in (2, 30, 325)]
AFTER_ACTIVATION = {("active_bank", 2), ("orient_to", 6), ("touch_towards", 325), ("touch_towards", 360)}


class Tripwire:
    """A device that does `then` just before the `count`-th call of `name`, and counts only until it has."""

    def __init__(self, device: Any, name: str, count: int, then: Callable[[], None]) -> None:
        self._device, self._name, self._left, self._then = device, name, count, then

    @property
    def tripped(self) -> bool:
        return self._left <= 0

    def __getattr__(self, name: str) -> Any:
        if name == self._name:
            self._left -= 1
            if self._left == 0:
                self._then()
        return getattr(self._device, name)


class Cut(Tripwire):
    """Device whose link fails from that call on."""

    def __getattr__(self, name: str) -> Any:
        if self.tripped and name != "close":
            return self._gone
        return super().__getattr__(name)

    @staticmethod
    def _gone(*_: Any, **__: Any) -> Any:
        raise LinkLost("connection reset", link="127.0.0.1:502")


def with_device(rig: Rig, device: Any) -> Rig:
    roles = dict.fromkeys(("machine", "probe", "store", "thermometer", "operator"), device)
    return dataclasses.replace(rig, devices={"twin": device}, mounts=dict.fromkeys(rig.mounts, device), **roles)


@dataclasses.dataclass
class Broken:
    """A night with a former table active and a tripwire in its only device."""

    state: Path

    def run(self, kind: type[Tripwire], place: tuple[str, int], then: Callable[[], None]):
        wires: list[Tripwire] = []

        def tamper(rig: Rig) -> Rig:
            rig.store.stage(1, FORMER)
            rig.store.activate(1)
            wires.append(kind(rig.devices["twin"], *place, then))
            return with_device(rig, wires[0])

        self.night = Night(tamper=tamper)
        ended = self.night.run(short_document(self.state), self._keep, files=False)
        assert wires[0].tripped, "the run never came to this place"
        return ended

    def _keep(self, supervisor: Supervisor) -> None:
        self.supervisor = supervisor

    def abort(self) -> None:
        self.supervisor.request_abort("SIGINT")

    @property
    def former_acts(self) -> bool:
        return self.night.active == 1 and self.night.banks[1].same_as(FORMER)

    @property
    def at_rest(self) -> bool:
        world = self.night.world
        assert world is not None
        world.advance_to(world.now + 60.0)
        return world.controller.motion.value in ("idle", "fault") and not world.collisions


@pytest.fixture
def broken(state: Path) -> Broken:
    return Broken(state)


def place_name(place: tuple[str, int]) -> str:
    return f"{place[0]}-{place[1]}"


@pytest.mark.parametrize("place", PLACES, ids=place_name)
def test_abort_leaves_the_table_as_it_was(broken: Broken, place: tuple[str, int]) -> None:
    ended = broken.run(Tripwire, place, broken.abort)
    assert isinstance(ended.error, Aborted)
    assert ended.error.exit_code == 5
    assert ended.outcome.state is RunState.ABORTED
    run = stored_run(broken.state)
    assert run.states[-2:] == ["aborting", "aborted"]
    assert (run.row.state, run.row.ended is not None) == ("aborted", True)
    assert (broken.night.active, broken.former_acts) == (1, True)
    assert broken.at_rest
    if place in AFTER_ACTIVATION:
        assert run.results("restore/active-bank") == [1]


@pytest.mark.parametrize("place", FEW, ids=place_name)
def test_refused_command_names_step_and_leaves_the_table_as_it_was(broken: Broken, place: tuple[str, int]) -> None:
    def refuse() -> None:
        raise CommandRejected("the controller refused", device="twin")

    ended = broken.run(Tripwire, place, refuse)
    assert isinstance(ended.error, CommandRejected)
    assert ended.error.exit_code == 3
    assert ended.outcome.state is RunState.FAULTED
    assert (broken.night.active, broken.former_acts) == (1, True)
    assert broken.at_rest
    reason = str(stored_run(broken.state).row.reason)
    assert "the controller refused" in reason
    assert ended.error.where["step"] in reason


@pytest.mark.parametrize("place", FEW, ids=place_name)
def test_lost_link_names_link_and_step_and_what_it_could_not_restore(broken: Broken, place: tuple[str, int]) -> None:
    def lose() -> None:
        raise LinkLost("connection reset", link="127.0.0.1:502")

    ended = broken.run(Cut, place, lose)
    assert isinstance(ended.error, LinkLost)
    assert ended.outcome.state is RunState.FAULTED
    assert ended.error.where["link"] == "127.0.0.1:502"
    assert ended.error.where["step"]
    assert broken.night.active in (1, 2)
    assert broken.night.banks[1].same_as(FORMER)
    reason = str(stored_run(broken.state).row.reason)
    if broken.night.active == 1 and place != ("activate", 1):
        assert "could not be made active again" not in reason
    else:
        assert "bank 1 could not be made active again" in reason


def test_bank_that_does_not_become_active_is_noticed(broken: Broken, monkeypatch) -> None:
    def tamper(rig: Rig) -> Rig:
        rig.store.stage(1, FORMER)
        rig.store.activate(1)
        monkeypatch.setattr(rig.devices["twin"], "activate", lambda _: None, raising=False)
        return rig

    night = Night(tamper=tamper)
    ended = night.run(short_document(broken.state), files=False)
    assert isinstance(ended.error, ReadBackMismatch)
    assert ended.error.where["step"].startswith("activate/")
    assert ended.outcome.state is RunState.FAULTED
    assert ended.outcome.table_bank == 1
    assert night.active == 1


def test_table_that_reads_back_differently_is_never_activated(broken: Broken, monkeypatch) -> None:
    def tamper(rig: Rig) -> Rig:
        whole = rig.store.read_table

        def one_count_off(bank: int) -> TableImage | None:
            image = whole(bank)
            assert image is not None
            counts = image.counts.copy()
            counts[0, 0, 0, 0] += 1
            return dataclasses.replace(image, counts=counts)

        monkeypatch.setattr(rig.devices["twin"], "read_table", one_count_off, raising=False)
        return rig

    night = Night(tamper=tamper)
    ended = night.run(short_document(broken.state), files=False)
    assert isinstance(ended.error, ReadBackMismatch)
    assert "step publish/" in str(ended.error)
    assert ended.outcome.state is RunState.FAULTED
    assert stored_run(broken.state).steps_of("ActivateBank") == []
    assert night.active == 0


@pytest.mark.parametrize("place", [("touch_towards", 30), ("activate", 1), ("touch_towards", 325)], ids=place_name)
def test_full_disk_stops_the_run_and_the_table_is_as_it_was_all_the_same(
    broken: Broken, monkeypatch, place: tuple[str, int]
) -> None:
    """A run that cannot be journaled must not continue; the withdrawal does not wait for the disk."""

    def fill_disk() -> None:
        def full(*_: object) -> None:
            raise JournalFailed("the journal cannot be written: database or disk is full")

        monkeypatch.setattr(RunJournal, "_execute", full)

    ended = broken.run(Tripwire, place, fill_disk)
    assert isinstance(ended.error, JournalFailed)
    assert ended.outcome.state is RunState.FAULTED
    assert (broken.night.active, broken.former_acts) == (1, True)
    assert broken.at_rest


def test_door_that_opened_during_the_proof_does_not_keep_the_new_table(broken: Broken) -> None:
    """A controller in fault takes no table command: its fault is cleared first."""

    def open_door() -> None:
        world = broken.night.world
        assert world is not None
        world.controller.fail("door opened")

    ended = broken.run(Tripwire, ("touch_towards", 325), open_door)
    assert ended.outcome.state is RunState.FAULTED
    assert (broken.night.active, broken.former_acts) == (1, True)
    assert "restore/reset" in [step.key for step in stored_run(broken.state).steps]


@pytest.mark.parametrize("end", ["abort", "failed proof"])
def test_former_bank_that_somebody_writes_during_the_proof_is_told_and_not_called_restored(
    tmp_path: Path, end: str
) -> None:
    state = tmp_path / "state"
    stores: list[Any] = []
    supervisors: list[Supervisor] = []
    other = dataclasses.replace(FORMER, counts=-100 * FORMER.counts)

    def tamper(rig: Rig) -> Rig:
        if not stores:
            rig.store.stage(1, FORMER)
            rig.store.activate(1)
            stores.append(rig.store)
        return dataclasses.replace(rig, store=WrongSign(rig.store)) if end == "failed proof" else rig

    night = Night(tamper=tamper)
    job = prepare_job(Settings.model_validate(short_document(state)), Path.cwd())
    seen: list[str] = []

    def observe(step: Step, _: object) -> None:
        if isinstance(step, ActivateBank) or (seen == ["ActivateBank"] and isinstance(step, TouchTowards)):
            seen.append(type(step).__name__)
            if seen == ["ActivateBank", "TouchTowards"]:
                stores[0].stage(1, other)
                if end == "abort":
                    supervisors[-1].request_abort("panel")

    hooks = dataclasses.replace(night.hooks, observe=observe, attach=supervisors.append)
    ended = carry_out(job, FullCalibration(), Path.cwd(), hooks)
    assert stores[0].active_bank() == 1
    assert ended.outcome.state is RunState.FAULTED
    assert ended.outcome.table_bank == 1
    assert "bank 1 holds another table than before the run" in ended.outcome.reason
    assert isinstance(ended.error, Aborted if end == "abort" else ReadBackMismatch)
    with open_journal(state) as reader:
        row = reader.last_run()
        assert row is not None
        restored = [table.crc32 for table in reader.tables(row.run) if table.role == "restored"]
    sign = 1 if end == "abort" else -1  # of what the controller applies beside what it reads back
    assert restored == [table_digest(dataclasses.replace(other, counts=sign * other.counts))]

    def refuse(*_: object) -> None:
        raise PlanRefused("the test ends here")

    told: list[str] = []
    hooks = dataclasses.replace(
        night.hooks, preflight_passed=refuse, announce=lambda announced: told.append(announced.text)
    )
    carry_out(job, FullCalibration(), Path.cwd(), hooks)
    assert any("the active compensation is not the one expected after the last run" in text for text in told)
