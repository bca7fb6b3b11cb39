"""Run that lost its link, resumed or abandoned: measurements are retained, and one of both tables is active."""

from __future__ import annotations

import copy
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from journal_surgery import change_start_of_measuring, rename_steps
from nights import CONFIG, Night, short_document
from stored_run import stored_run
from test_whole_run import WrongSign
from test_whole_run_interrupted import FORMER, Cut, Tripwire, with_device

from agent.errors import Aborted, Busy, Interrupted, PlanDiverged, PlanRefused, ThermometerFault
from agent.execution.device_assembly import assemble
from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.execution.run_lock import run_lock
from agent.execution.run_record import run_ids
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.job_preparation import prepare_job
from agent.results.run_outcome import Decision
from agent.runs.kinds import nightly
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.reconcile import compensation_left, reconcile, unproved_table
from agent.runs.reconcile_result import CompensationState, ReconcileAction
from agent.runs.resume.abandon import abandon
from agent.runs.resume.resume import resume
from agent.runs.session import RunResult, carry_out
from agent.runs.unfinished_run import unfinished_run
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    InputError,
    LinkLost,
    MotionFault,
    NotActiveYet,
    PermissionMissing,
    StoreError,
    VolcalError,
)
from drivers.roles import Activation, Permission, StoreLimits

IN_A_BALL = ("touch_towards", 150)
IN_THE_PROOF = ("touch_towards", 350)


STATE = Path("state")
"""Relative: a copy of its directory is gone on with by changing into it."""


@dataclass
class Broken:
    """Run that lost its link, and the machine as it was left."""

    night: Night

    def copied(self, monkeypatch: pytest.MonkeyPatch, directory: Path) -> Broken:
        """Copy of it for one test alone, with its directory as working directory."""
        shutil.copytree(Path.cwd(), directory / "copy")
        monkeypatch.chdir(directory / "copy")
        night = Night()
        night.world = copy.deepcopy(self.night.world)
        return Broken(night)

    def resume(self) -> RunResult:
        return resume(STATE, self.night.hooks)

    @property
    def rig(self) -> Rig:
        """The machine, open, on a clock of its own."""
        made = assemble(Settings.model_validate(document()), VirtualClock(), Path.cwd())
        rig = self.night._with_first_world(made)
        rig.open()
        return rig


def document() -> dict[str, Any]:
    settings = short_document(STATE)
    settings["devices"]["twin"]["options"]["noise_by_step"] = True
    return settings


def broken_at(place: tuple[str, int]) -> Broken:
    def lose() -> None:
        raise LinkLost("connection reset", link="127.0.0.1:502")

    def tamper(rig: Rig) -> Rig:
        rig.store.stage(1, FORMER)
        rig.store.activate(1)
        return with_device(rig, Cut(rig.devices["twin"], *place, lose))

    night = Night(tamper=tamper)
    ended = night.run(document(), files=False)
    assert isinstance(ended.error, LinkLost), ended
    return Broken(night)


@contextmanager
def working_in(directory: Path) -> Iterator[None]:
    former = Path.cwd()
    os.chdir(directory)
    try:
        yield
    finally:
        os.chdir(former)


@pytest.fixture(scope="module")
def lost_measuring() -> Iterator[tuple[Path, Broken]]:
    with TemporaryDirectory() as directory, working_in(Path(directory)):
        yield Path(directory), broken_at(IN_A_BALL)


@pytest.fixture(scope="module")
def lost_proving() -> Iterator[tuple[Path, Broken]]:
    with TemporaryDirectory() as directory, working_in(Path(directory)):
        yield Path(directory), broken_at(IN_THE_PROOF)


@pytest.fixture
def measuring(lost_measuring, monkeypatch, tmp_path: Path) -> Broken:
    monkeypatch.chdir(lost_measuring[0])
    return lost_measuring[1].copied(monkeypatch, tmp_path)


@pytest.fixture
def proving(lost_proving, monkeypatch, tmp_path: Path) -> Broken:
    monkeypatch.chdir(lost_proving[0])
    return lost_proving[1].copied(monkeypatch, tmp_path)


def test_measured_balls_are_not_measured_again(measuring: Broken) -> None:
    unfinished = unfinished_run(STATE)
    assert unfinished is not None
    assert unfinished.resumable
    assert unfinished.state is RunState.FAULTED
    before = stored_run(STATE).balls
    assert len(before) == unfinished.balls > 0
    ended = measuring.resume()
    assert ended.error is None
    assert ended.outcome.state is RunState.COMPLETE
    assert ended.outcome.run_id == unfinished.run_id
    run = stored_run(STATE)
    assert run.balls[: len(before)] == before
    assert run.measured_twice == []
    [moved] = [event.record for event in run.events if "resume-1/datum/found" in event.record_text]
    assert np.linalg.norm(moved["moved_um"]) < 5.0
    assert measuring.night.active == 2
    assert unfinished_run(STATE) is None


def test_a_run_is_resumed_in_the_directory_in_which_it_was_found(measuring: Broken, tmp_path: Path) -> None:
    moved = tmp_path / "other-disk"
    shutil.move(STATE, moved)
    before = stored_run(moved).balls
    with run_lock(moved, "of another process"), pytest.raises(Busy):
        resume(moved, measuring.night.hooks)
    ended = resume(moved, measuring.night.hooks)
    assert ended.error is None
    assert ended.outcome.state is RunState.COMPLETE
    run = stored_run(moved)
    assert run.balls[: len(before)] == before
    assert run.measured_twice == []
    assert not STATE.exists()


def test_a_run_that_another_process_ends_before_the_lock_is_free_is_not_resumed(measuring: Broken) -> None:
    @contextmanager
    def given_up_meanwhile(directory: Path, owner: str) -> Iterator[None]:
        abandon(measuring.rig, STATE, "another process")
        with run_lock(directory, owner):
            yield

    with pytest.raises(InputError, match="no run to resume"):
        resume(STATE, replace(measuring.night.hooks, lock=given_up_meanwhile))
    assert stored_run(STATE).row.state == "aborted"


def test_a_file_that_has_changed_is_refused_by_name(lost_measuring, measuring: Broken) -> None:
    positions = lost_measuring[0] / "three-positions.csv"
    former = positions.read_text()
    positions.write_text(f"{former}1,90,0\n")
    try:
        with pytest.raises(PlanDiverged) as refused:
            measuring.resume()
    finally:
        positions.write_text(former)
    assert refused.value.where["file"].endswith("three-positions.csv")
    assert unfinished_run(STATE) is not None


def test_a_plan_that_diverges_names_both_keys_and_moves_nothing(measuring: Broken) -> None:
    """One recorded step has another key, as another version might have written it."""
    rename_steps(STATE, "measure/%/orient", "measure/elsewhere")
    ended = measuring.resume()
    assert isinstance(ended.error, PlanDiverged)
    assert ended.error.where["recorded"] == "measure/elsewhere"
    assert ended.error.where["asked"].endswith("/orient")
    assert ended.outcome.state is RunState.FAULTED
    assert not [step.key for step in stored_run(STATE).steps if step.key.startswith(("resume-", "recover/withdraw"))]
    assert measuring.night.active == 1


def test_the_position_of_an_artefact_that_was_moved_is_measured_again_and_only_it(measuring: Broken) -> None:
    world = measuring.night.world
    assert world is not None
    before = {ball.key: ball.record_text for ball in stored_run(STATE).balls}
    world.place_artefact(1)
    ended = measuring.resume()
    assert ended.error is None, ended.error
    assert ended.outcome.state is RunState.COMPLETE
    run = stored_run(STATE)
    after = {ball.key: ball.record_text for ball in run.balls}
    discarded = {event.record["ball"] for event in run.events if event.kind == "discarded"}
    assert discarded
    assert len({key.split("/ball")[0] for key in discarded}) == 1
    assert {key for key in before if after[key] != before[key]} == discarded
    assert [event.record["type"] for event in run.events if event.kind == "fault"] == ["LinkLost", "ArtefactMoved"]
    assert unfinished_run(STATE) is None


@pytest.mark.parametrize("fault", ["emergency stop", "drive fault of axis Y"])
def test_a_run_after_an_emergency_stop_or_a_drive_fault_goes_on(
    fault: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    nights: list[Night] = []

    def fail() -> None:
        world = nights[0].world
        assert world is not None
        world.controller.fail(fault)

    def tamper(rig: Rig) -> Rig:
        return with_device(rig, Tripwire(rig.devices["twin"], *IN_A_BALL, fail))

    nights.append(Night(tamper=tamper))
    ended = nights[0].run(document(), files=False)
    assert isinstance(ended.error, (MotionFault, PermissionMissing, CommandRejected)), ended
    unfinished = unfinished_run(STATE)
    assert unfinished is not None
    assert unfinished.resumable
    before = stored_run(STATE).balls
    after = Night()
    after.world = nights[0].world
    resumed = Broken(after).resume()
    assert resumed.error is None, resumed.error
    run = stored_run(STATE)
    assert run.balls[: len(before)] == before
    assert run.measured_twice == []
    touched = [event.record for event in run.events if event.kind == "event" and "moved_um" in event.record_text]
    assert len(touched) == 2  # the ball found last and the one farthest from it


class WildThermometer:
    """Device whose readings number `first` to before `end` are 85 °C for the artefact, as of a sensor that has lost its
    supply."""

    def __init__(self, device: Any, first: int, end: int) -> None:
        self._device, self._wild, self.readings = device, range(first, end), 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def temperatures_c(self) -> dict[str, float]:
        self.readings += 1
        found = dict(self._device.temperatures_c())
        return found | {"artefact": 85.0} if self.readings in self._wild else found


def test_one_wild_reading_of_a_thermometer_is_read_again_and_noted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    night = Night(tamper=lambda rig: with_device(rig, WildThermometer(rig.devices["twin"], 20, 22)))
    job = prepare_job(Settings.model_validate(document()), Path.cwd())
    ended = carry_out(job, FullCalibration(), Path.cwd(), night.hooks)  # not as walked: it reads more than once
    assert ended.error is None, ended.error
    run = stored_run(STATE)
    [note] = [event.record for event in run.events if "readings_not_used" in event.record_text]
    assert "to 85.00 °C" in note["note"]
    assert note["readings_not_used"] == 2
    used_c = [ball.record["temperature_c"] for ball in run.balls]
    assert max(used_c) - min(used_c) < 1.0
    with open_journal(STATE) as journal:
        assert max(row.record["artefact"] for row in journal.temperatures(journal.runs()[-1].run)) < 30.0


def test_a_run_whose_thermometer_stays_wild_ends_and_goes_on_when_it_is_put_right(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    night = Night(tamper=lambda rig: with_device(rig, WildThermometer(rig.devices["twin"], 20, 10**9)))
    ended = night.run(document(), files=False)
    assert isinstance(ended.error, ThermometerFault), ended
    assert "jumped from" in str(ended.error)
    assert "resume" in ended.error.hint
    unfinished = unfinished_run(STATE)
    assert unfinished is not None
    assert unfinished.resumable
    before = stored_run(STATE).balls
    still_wild = Night(tamper=lambda rig: with_device(rig, WildThermometer(rig.devices["twin"], 1, 10**9)))
    still_wild.world = night.world
    assert isinstance(Broken(still_wild).resume().error, ThermometerFault)
    after = Night()
    after.world = night.world
    resumed = Broken(after).resume()
    assert resumed.error is None, resumed.error
    assert resumed.outcome.state is RunState.COMPLETE
    run = stored_run(STATE)
    assert run.balls[: len(before)] == before
    assert run.measured_twice == []
    assert max(ball.record["temperature_c"] for ball in run.balls) < 30.0


def test_an_aborted_run_cannot_be_resumed(measuring: Broken) -> None:
    result = abandon(measuring.rig, STATE, "test")
    assert result.action is ReconcileAction.NOTHING
    run = stored_run(STATE).row
    assert (run.state, run.ended is not None) == ("aborted", True)
    with pytest.raises(InputError, match="no run to resume"):
        measuring.resume()


def test_an_unproved_table_is_taken_back_and_the_run_can_still_prove_it(proving: Broken) -> None:
    assert proving.night.active == 2
    with_rig = proving.rig
    found = reconcile(with_rig, STATE, restore=False)
    assert (found.state, found.action, proving.night.active) == (CompensationState.UNPROVED, ReconcileAction.LEFT, 2)
    restored = reconcile(with_rig, STATE)
    assert (restored.state, restored.action, proving.night.active) == (
        CompensationState.UNPROVED,
        ReconcileAction.RESTORED,
        1,
    )
    assert reconcile(with_rig, STATE).state is CompensationState.NOT_ACTIVATED
    ended = proving.resume()
    assert ended.error is None
    assert ended.outcome.proof is not None and ended.outcome.proof.accepted
    assert proving.night.active == 2
    assert reconcile(proving.rig, STATE).state is CompensationState.AS_EXPECTED
    assert len(stored_run(STATE).results("publish/stage")) == 1


def test_another_run_does_not_take_an_unproved_table_for_granted(proving: Broken) -> None:
    ended = proving.night.run(document(), files=False)
    assert isinstance(ended.error, PlanRefused)
    assert "volcal resume" in str(ended.error)
    unfinished = unfinished_run(STATE)
    assert unfinished is not None and unfinished.run == 1
    result = abandon(proving.rig, STATE, "test")
    assert (result.action, proving.night.active) == (ReconcileAction.RESTORED, 1)
    assert unfinished_run(STATE) is None


def test_a_run_of_another_machine_neither_begins_nor_hides_an_unproved_table(proving: Broken) -> None:
    """Two settings files in one folder share the default state directory."""
    lathe = Path(shutil.copytree(CONFIG / "machines", "machines")) / "case-study.toml"
    lathe.write_text(lathe.read_text().replace('name = "case-study"', 'name = "lathe-3"', 1))
    before = stored_run(STATE).row
    with pytest.raises(ConfigurationError, match="of another machine") as refused:
        Night().run(document() | {"machine": str(lathe.resolve())}, files=False)
    assert refused.value.where["key"] == "state_directory"
    assert run_ids(STATE) == (before.run_id,)
    left = compensation_left(proving.rig, STATE)
    assert left is not None and left.blocks_runs and left.unproved is not None and left.unproved.provable


class Refusing:
    """Device that refuses to activate the former bank as often as stated."""

    def __init__(self, device: Any, times: int) -> None:
        self._device, self.left = device, times

    def activate(self, bank: int) -> None:
        if bank == 1 and self.left > 0:
            self.left -= 1
            raise CommandRejected("bank locked", device="twin")
        self._device.activate(bank)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


def refusing(broken: Broken, times: int) -> Rig:
    rig = broken.rig
    return with_device(rig, Refusing(rig.devices["twin"], times))


def end_as_aborted(broken: Broken) -> str:
    """End the run as a stop does whose restore failed, and return its identity."""
    unfinished = unfinished_run(STATE)
    assert unfinished is not None
    journal = Journal(STATE)
    journal.continue_run(unfinished.run, unfinished.run_id, broken.rig.clock)[0].aside().state(
        RunState.ABORTED, "stopped during the proof; the restore failed", final=True
    )
    journal.close()
    return unfinished.run_id


def test_everyone_names_the_same_sequence_out_of_an_unproved_table(proving: Broken) -> None:
    run_id = end_as_aborted(proving)
    unproved = unproved_table(STATE)
    assert unproved is not None and unproved.provable
    assert unproved.situation == f"bank 2 is active with a table of run {run_id} that was never proved"
    places = [unproved.way_out.index(command) for command in ("--restore", "`volcal resume` resumes", "--give-up")]
    assert places == sorted(places)
    left = compensation_left(proving.rig, STATE)
    assert left is not None and left.blocks_runs and left.unproved == unproved
    started = proving.night.run(document(), files=False)
    assert isinstance(started.error, PlanRefused)
    for text in (left.text, str(started.error)):
        assert unproved.way_out in text


def test_a_restore_that_fails_twice_is_tried_again_and_leaves_the_run_as_it_is(proving: Broken) -> None:
    end_as_aborted(proving)
    rig = refusing(proving, 2)
    for _ in range(2):
        failed = reconcile(rig, STATE)
        assert (failed.action, failed.refused, proving.night.active) == (ReconcileAction.LEFT, "bank locked", 2)
        assert failed.unproved is not None and failed.unproved.way_out in failed.text
        assert unproved_table(STATE) is not None
    restored = reconcile(rig, STATE)
    assert (restored.action, restored.unproved, proving.night.active) == (ReconcileAction.RESTORED, None, 1)
    assert unproved_table(STATE) is None
    settled = compensation_left(rig, STATE)
    assert settled is not None and not settled.blocks_runs


def test_a_restore_whose_answer_was_lost_counts(proving: Broken, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = proving.rig
    device = rig.devices["twin"]
    activate = device.activate  # type: ignore[attr-defined]  # the only device plays every role

    def unheard(bank: int) -> None:
        activate(bank)
        raise CommandRejected("no answer", device="twin")

    monkeypatch.setattr(device, "activate", unheard, raising=False)
    assert reconcile(rig, STATE).action is ReconcileAction.RESTORED
    assert unproved_table(STATE) is None


def test_a_run_that_was_stopped_proves_its_table_if_the_restore_never_works(proving: Broken) -> None:
    end_as_aborted(proving)
    assert reconcile(refusing(proving, 9), STATE).refused
    ended = proving.resume()
    assert ended.error is None
    assert ended.outcome.proof is not None and ended.outcome.proof.accepted
    assert proving.night.active == 2
    assert unproved_table(STATE) is None
    assert reconcile(proving.rig, STATE).state is CompensationState.AS_EXPECTED


def test_a_stop_during_the_proof_whose_restore_failed_can_be_proved(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    supervisors: list[Supervisor] = []

    def tamper(rig: Rig) -> Rig:
        rig.store.stage(1, FORMER)
        rig.store.activate(1)
        stubborn = Refusing(rig.devices["twin"], 99)
        return with_device(rig, Tripwire(stubborn, *IN_THE_PROOF, lambda: supervisors[0].request_abort("SIGINT")))

    night = Night(tamper=tamper)
    stopped = night.run(document(), supervisors.append, files=False)
    assert stopped.outcome.state is not RunState.COMPLETE
    assert night.active == 2
    unproved = unproved_table(STATE)
    assert unproved is not None and unproved.provable
    assert reconcile(refusing(Broken(night), 1), STATE).refused
    night.tamper = lambda rig: rig
    ended = Broken(night).resume()
    assert ended.error is None
    assert ended.outcome.proof is not None and ended.outcome.proof.accepted
    assert night.active == 2
    assert unproved_table(STATE) is None


@pytest.mark.parametrize(("refusals", "active"), [(0, 1), (99, 2)], ids=["restore-works", "restore-never-works"])
def test_a_proof_that_fails_after_the_resumption_takes_the_table_back_or_says_that_it_could_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refusals: int, active: int
) -> None:
    monkeypatch.chdir(tmp_path)
    supervisors: list[Supervisor] = []

    def stopped_in_the_proof(rig: Rig) -> Rig:
        WrongSign(rig.store).stage(1, FORMER)
        rig.store.activate(1)
        stubborn = Refusing(rig.devices["twin"], 99)
        wire = Tripwire(stubborn, *IN_THE_PROOF, lambda: supervisors[0].request_abort("SIGINT"))
        return replace(with_device(rig, wire), store=WrongSign(wire))

    night = Night(tamper=stopped_in_the_proof)
    night.run(document(), supervisors.append, files=False)
    assert night.active == 2

    def resumed(rig: Rig) -> Rig:
        device = Refusing(rig.devices["twin"], refusals)
        return replace(with_device(rig, device), store=WrongSign(device))

    night.tamper = resumed
    ended = resume(STATE, night.hooks)
    assert ended.outcome.proof is not None and not ended.outcome.proof.accepted
    assert night.active == active
    left = unproved_table(STATE)
    assert (left is None) == (active == 1)
    if left is not None:
        assert not left.provable
        assert "cannot prove its table" in left.way_out


def test_giving_up_says_what_is_active_and_what_to_do_at_the_controller(proving: Broken) -> None:
    run_id = end_as_aborted(proving)
    result = abandon(refusing(proving, 9), STATE, "test")
    assert (result.action, result.refused, proving.night.active) == (ReconcileAction.LEFT, "bank locked", 2)
    row = stored_run(STATE).row
    assert row.state == "aborted" and "bank 2 is active" in (row.reason or "")
    left = unproved_table(STATE)
    assert left is not None and not left.provable
    assert f"run {run_id} has ended and cannot prove its table" in left.way_out
    assert "activate bank 1 at the controller" in left.way_out
    with pytest.raises(InputError, match="no run to resume") as refused:
        proving.resume()
    assert left.way_out in refused.value.hint
    proving.rig.store.activate(1)  # by the operator
    settled = compensation_left(proving.rig, STATE)
    assert settled is not None and not settled.blocks_runs


def test_while_another_process_owns_the_machine_its_table_is_not_judged(proving: Broken) -> None:
    with run_lock(STATE, "of another process"):
        assert compensation_left(proving.rig, STATE) is None


def test_with_an_open_door_the_compensation_is_left_as_it_is(proving: Broken) -> None:
    world = proving.night.world
    assert world is not None
    world.controller.granted[Permission.DOORS_CLOSED] = False
    result = reconcile(proving.rig, STATE)
    assert (result.action, proving.night.active) == (ReconcileAction.LEFT, 2)
    assert "doors closed" in result.instruction


def test_a_table_activated_by_somebody_else_is_reported_and_left(proving: Broken) -> None:
    world = proving.night.world
    assert world is not None
    world.controller.activate(0)
    result = reconcile(proving.rig, STATE)
    assert (result.state, result.action, proving.night.active) == (CompensationState.CHANGED, ReconcileAction.LEFT, 0)


def test_a_resumption_that_is_interrupted_while_it_is_planned_can_be_made_again(measuring: Broken) -> None:
    before = stored_run(STATE).balls

    def stopped(supervisor: Supervisor) -> None:
        supervisor.request_interruption("the service is being stopped")

    ended = resume(STATE, replace(measuring.night.hooks, attach=stopped))
    assert isinstance(ended.error, Interrupted)
    assert ended.outcome.state is RunState.FAULTED
    unfinished = unfinished_run(STATE)
    assert unfinished is not None and unfinished.resumable
    assert unfinished.reason == ended.outcome.reason == "interrupted: the service is being stopped"
    assert measuring.resume().outcome.state is RunState.COMPLETE
    run = stored_run(STATE)
    assert run.balls[: len(before)] == before
    assert run.measured_twice == []


@pytest.mark.parametrize("error", [ConfigurationError("$10=0"), StoreError("the file of the bank is damaged")])
def test_a_run_is_not_lost_if_a_device_cannot_be_opened_for_its_resumption(proving: Broken, error: VolcalError) -> None:
    def refuse() -> None:
        raise error

    def tamper(rig: Rig) -> Rig:
        rig.devices["twin"].open = refuse  # type: ignore[method-assign]
        return rig

    before, former = stored_run(STATE).balls, unfinished_run(STATE)
    proving.night.tamper = tamper
    ended = proving.resume()
    assert ended.error is error
    assert ended.outcome.state is RunState.FAULTED
    found = unfinished_run(STATE)
    assert former is not None and found is not None
    assert (found.run_id, found.balls, found.resumable) == (former.run_id, len(before), True)
    assert found.reason == ended.outcome.reason
    left = unproved_table(STATE)
    assert left is not None and left.provable and left.situation in found.reason


@pytest.mark.parametrize("refusals", [0, 9], ids=["restore-works", "restore-never-works"])
def test_an_aborted_resumption_takes_the_unproved_table_back_or_names_it(proving: Broken, refusals: int) -> None:
    proving.night.tamper = lambda rig: with_device(rig, Refusing(rig.devices["twin"], refusals))
    ended = resume(STATE, replace(proving.night.hooks, attach=lambda supervisor: supervisor.request_abort("SIGINT")))
    assert isinstance(ended.error, Aborted)
    assert ended.outcome.state is RunState.ABORTED
    assert stored_run(STATE).row.reason == ended.outcome.reason
    left, reason = unproved_table(STATE), ended.outcome.reason
    if refusals:
        assert left is not None and left.provable and f"{left.situation}: bank locked" in reason
        assert proving.night.active == 2
    else:
        assert left is None and "the former table acts again" in reason
        assert proving.night.active == 1


class Late:
    """Store whose controller activates a bank only after a power cycle."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.waiting: int | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def store_limits(self) -> StoreLimits:
        return replace(self._device.store_limits(), activation=Activation.POWER_CYCLE)

    def activate(self, bank: int) -> None:
        self.waiting = bank

    def pending_bank(self) -> int | None:
        return self.waiting

    def switched_off_and_on(self) -> None:
        if self.waiting is not None:
            self._device.activate(self.waiting)
            self.waiting = None


def test_a_table_that_waits_for_a_restart_is_completed_by_the_next_start(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    stores: list[Late] = []

    def tamper(rig: Rig) -> Rig:
        if not stores:
            stores.append(Late(rig.devices["twin"]))
        return replace(rig, store=stores[0])

    broken = Broken(Night(tamper=tamper))
    ended = broken.night.run(document(), files=False)
    assert isinstance(ended.error, NotActiveYet)
    assert ended.outcome.state is RunState.WRITTEN
    assert "switched off and on" in str(ended.error)
    run = stored_run(STATE).row
    assert (run.state, run.ended) == ("written, not active", None)
    rig = tamper(broken.rig)
    waiting = reconcile(rig, STATE)
    assert (waiting.state, waiting.action, waiting.waiting_bank) == (
        CompensationState.WAITING,
        ReconcileAction.LEFT,
        stores[0].waiting,
    )
    assert "switch the controller off and on" in waiting.instruction
    early = broken.resume()
    assert isinstance(early.error, NotActiveYet)
    assert early.outcome.state is RunState.WRITTEN
    stores[0].switched_off_and_on()
    ended = broken.resume()
    assert ended.error is None
    assert ended.outcome.state is RunState.COMPLETE
    assert ended.outcome.proof is not None
    assert ended.outcome.proof.accepted
    assert len(stored_run(STATE).steps_of("ActivateBank")) == 1
    assert reconcile(rig, STATE).state is CompensationState.AS_EXPECTED


def test_a_night_goes_on_while_its_slot_lasts(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "night").mkdir()
    monkeypatch.chdir(tmp_path / "night")
    wide = {"slot_minutes": 30.0, "check_positions": 1, "max_chi2": 4.0, "max_ve_growth": 20.0, "step_evidence": 30.0}
    settings = short_document(STATE, nightly=wide, clock={"kind": "real"})
    broken = Broken(Night())
    assert broken.night.run(settings, files=False).outcome.state is RunState.COMPLETE

    def lose() -> None:
        raise LinkLost("connection reset", link="127.0.0.1:502")

    broken.night.tamper = lambda rig: with_device(rig, Cut(rig.devices["twin"], "touch_towards", 150, lose))
    ended = broken.night.run(settings, files=False, kind=nightly.Night(nights=1.0))
    assert isinstance(ended.error, LinkLost)
    in_the_morning = broken.copied(monkeypatch, tmp_path)
    earlier = (datetime.now(UTC) - timedelta(hours=10)).isoformat(timespec="milliseconds")
    change_start_of_measuring(STATE, 2, earlier)
    late = in_the_morning.resume()
    assert isinstance(late.error, PlanRefused)
    assert "are left of its slot" in str(late.error)
    assert len(stored_run(STATE, late.outcome.run_id).touches) < 150

    monkeypatch.chdir(tmp_path / "night")
    broken.night.tamper = lambda rig: rig
    went_on = broken.resume()
    assert went_on.error is None
    assert went_on.outcome.night is not None
    assert went_on.outcome.night.nights == 1.0
    assert went_on.outcome.night.decision in (Decision.WRITTEN, Decision.FUSED)
    assert len(stored_run(STATE, went_on.outcome.run_id).touches) > 150
    assert all(stored_run(STATE, run_id).measured_twice == [] for run_id in run_ids(STATE))
