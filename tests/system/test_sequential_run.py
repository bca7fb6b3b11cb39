"""Calibration that chooses each position from what it has measured: what it walks, proves, carries out and resumes."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import pytest

from agent.errors import GateRefused, PlanRefused
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.execution.steps import Plan, Record
from agent.planning.design.sequential_candidates import MIN_POSITIONS, SequentialCandidates, standing_in
from agent.planning.job_preparation import prepare_job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.probing.ball import point
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions, position_key
from agent.runs.kinds import sequential
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.kinds.calibration import CalibrationTask
from agent.runs.kinds.sequential import STOP, SequentialEnd, SequentialTask, sequential_calibration, with_positions
from agent.runs.kinds.slot import AvailableTime
from agent.runs.session import RunResult
from agent.settings.schema import Settings
from campaigns.resume.case import (
    Killed,
    KillSwitch,
    ResumeMachine,
    patch_journal,
    prepare_case,
    signature,
)

SLOT = 24.0
KIND = FullCalibration(sequential=True, slot_minutes=SLOT)
REACHING = replace(KIND, target_vce_um=1e3)
STATE = Path("state")
AT_FOUND_BALLS = re.compile(r"/(repeat|via|away)-\d+|/ball-\d+/found")


@pytest.fixture(scope="module", autouse=True)
def candidates_computed_once() -> Iterator[None]:
    """What follows from the settings alone is computed in the first run of this file, and taken from there by all other
    runs with equal settings: the candidates, their models and their times."""
    known: dict[object, object] = {}

    def once(name: str, compute: Callable[[SequentialCandidates], object]) -> cached_property[object]:
        def found(candidates: SequentialCandidates) -> object:
            job = candidates.job
            settings = job.settings.model_dump(exclude={"procedure": {"position_set"}})  # a path; its positions count
            key = (name, job.positions, repr(settings))
            if key not in known:
                known[key] = compute(candidates)
            return known[key]

        kept = cached_property(found)
        kept.__set_name__(SequentialCandidates, name)
        return kept

    with pytest.MonkeyPatch.context() as patched:
        for name in ("positions", "models", "_seconds_at_rest", "_tails"):
            compute = vars(SequentialCandidates)[name].func
            patched.setattr(SequentialCandidates, name, once(name, compute))
        yield


@pytest.fixture
def in_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def carried_out(directory: Path, kind: FullCalibration) -> tuple[Path, Settings, ResumeMachine, RunResult]:
    former = Path.cwd()
    os.chdir(directory)
    try:
        settings, machine = prepare_case(directory)
        return directory, settings, machine, machine.run(settings, kind=kind)
    finally:
        os.chdir(former)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Settings, ResumeMachine, RunResult]:
    """Sequential calibration without a target that was not interrupted, in its directory."""
    return carried_out(tmp_path_factory.mktemp("whole"), KIND)


@pytest.fixture(scope="module")
def reaching(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Settings, ResumeMachine, RunResult]:
    """The same with a target that is reached as soon as this is possible."""
    return carried_out(tmp_path_factory.mktemp("reaching"), REACHING)


def recorded(directory: Path, prefix: str = "") -> list[tuple[str, object]]:
    """Keys and results of the steps of the only run, in order."""
    with open_journal(directory / STATE) as reader:
        [row] = reader.runs()
        return [(step.key, step.result) for step in reader.steps(row.run) if step.key.startswith(prefix)]


def choices(directory: Path) -> list[str]:
    """Ways that the run has decided for, in order."""
    return [str(result) for key, result in recorded(directory, "sequential/choice-") if not key.endswith("/clock")]


def measured_names(directory: Path) -> list[str]:
    """Positions that the run has measured for its estimate, in order."""
    keys = [key.split("/") for key, _ in recorded(directory, "measure-")]
    return list(dict.fromkeys("/".join(key[1:3]) for key in keys if key[1].startswith("station-")))


class TestWholeRun:
    def test_the_table_is_written_and_proved(self, whole: tuple) -> None:
        _, _, _, ended = whole
        assert ended.error is None, ended.error
        assert ended.outcome.state is RunState.COMPLETE
        assert ended.outcome.proof is not None and ended.outcome.proof.accepted

    def test_it_ends_within_its_slot_with_the_proof(self, whole: tuple) -> None:
        _, _, _, ended = whole
        assert 0.7 * SLOT < ended.outcome.machine_minutes <= SLOT

    def test_each_position_is_measured_once_and_held_out_ones_are_not_chosen(self, whole: tuple) -> None:
        directory, settings, _, _ = whole
        chosen, end = measured_names(directory), choices(directory)[-1]
        held_out = {position_key(one) for one in prepare_job(settings, directory).held_out}
        assert end == STOP
        assert len(chosen) == len(set(chosen)) >= MIN_POSITIONS
        assert not held_out & set(chosen)

    def test_each_position_is_proved_before_its_first_motion(self, whole: tuple) -> None:
        keys = [key for key, _ in recorded(whole[0])]
        for number, name in enumerate(measured_names(whole[0])):
            first = next(place for place, key in enumerate(keys) if key.startswith(f"measure-{number}/"))
            assert keys.index(f"sequential/choice-{number}") < keys.index(f"sequential/proof-{number}") < first
            assert any(key.startswith(f"measure-{number}/{name}/") for key in keys)

    def test_the_scales_are_those_of_the_machine(self, whole: tuple) -> None:
        """The errors of this machine are ten times those of its family."""
        posteriors = [result for _, result in recorded(whole[0], "sequential/posterior-")]
        assert posteriors[0]["scales"] == [1.0] * 12  # type: ignore[index]
        assert max(posteriors[-1]["scales"][9:]) > 3.0  # type: ignore[index]

    def test_balls_have_the_numbers_of_their_positions(self, whole: tuple) -> None:
        with open_journal(whole[0] / STATE) as reader:
            [row] = reader.runs()
            balls = [ball.record for ball in reader.balls(row.run)]
        chosen, number_of = measured_names(whole[0]), dict[str, int]()
        for ball in balls:
            name = f"station-{ball['station']}/az{ball['azimuth_deg']:g}-el{ball['elevation_deg']:g}"
            number_of.setdefault(name, ball["position"])
        assert [number_of[name] for name in chosen] == list(range(len(chosen)))


def walked(whole: tuple) -> PreflightResult:
    """Preflight of the plan with the positions that the run has measured."""
    directory, settings, _, _ = whole
    job = prepare_job(settings, directory)
    candidates = SequentialCandidates(job)
    by_name = {position_key(one): one for one in candidates.positions}
    planned = tuple(by_name[name] for name in measured_names(directory))
    own = with_positions(job, planned)
    task = SequentialTask(CalibrationTask(own), candidates, SequentialEnd(None, AvailableTime(SLOT, 0.5)), planned)
    return run_preflight(own, lambda _: sequential_calibration(task))


def test_the_steps_of_the_run_are_those_of_a_walked_branch(whole: tuple) -> None:
    """The checks of the probe are made in the first position of the order that was expected, and a position that did
    not fit into the slot any more has no motion. Balls beside their nominal places are touched again, and the corners
    of a path depend on where the balls were found."""
    last = len(measured_names(whole[0]))
    beside = ("probe/", f"sequential/choice-{last}", f"sequential/proof-{last}")

    def measured(keys: Iterable[str]) -> list[str]:
        return [key for key in keys if not key.startswith(beside) and not AT_FOUND_BALLS.search(key)]

    carried_out = measured(key for key, _ in recorded(whole[0]))
    assert carried_out in [measured(branch.keys) for branch in walked(whole).branches]


@pytest.mark.parametrize("begins", ["measure-4/station-1", "sequential/proof-5", "held-out/station-1"])
def test_a_killed_run_goes_on_with_the_choices_of_its_journal(
    reaching: tuple, in_directory: Path, monkeypatch: pytest.MonkeyPatch, begins: str
) -> None:
    settings, machine = prepare_case(in_directory)
    switch = KillSwitch(lambda *_: None)
    switch.notify = lambda moment, step: switch.kill() if moment == "durable" and step.key.startswith(begins) else None
    restore = patch_journal(switch)
    try:
        with pytest.raises(Killed):
            machine.run(settings, switch, REACHING)
    finally:
        restore()
    before = choices(in_directory)
    computed: list[int] = []
    renew = sequential._Renewal.choice

    def counted(self: sequential._Renewal, *arguments: object) -> dict[str, object]:
        computed.append(len(arguments[0].positions))  # type: ignore[attr-defined]
        return renew(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(sequential._Renewal, "choice", counted)
    ended = machine.resume()
    assert ended.error is None, ended.error
    assert choices(in_directory) == choices(reaching[0])
    assert computed == list(range(len(before), len(choices(reaching[0]))))
    monkeypatch.chdir(reaching[0])
    expected = signature(reaching[2])
    monkeypatch.chdir(in_directory)
    assert signature(machine) == expected


class TestRefusals:
    def test_a_refused_position_falls_out_and_the_next_is_taken(
        self, in_directory: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        refused: list[str] = []

        def minutes(self: sequential._Proof, *arguments: object) -> float:
            if not refused:
                refused.append(position_key(self.positions[0]))
                return -1.0
            return proved(self, *arguments)  # type: ignore[arg-type]

        proved = sequential._Proof.minutes
        monkeypatch.setattr(sequential._Proof, "minutes", minutes)
        settings, machine = prepare_case(in_directory)
        ended = machine.run(settings, kind=REACHING)
        assert ended.error is None, ended.error
        keys = [key for key, _ in recorded(in_directory)]
        assert choices(in_directory)[0] == refused[0]
        assert "sequential/choice-0-1" in keys
        assert not any(f"/{refused[0]}/" in key for key in keys if key.startswith("measure-0"))

    def test_a_way_that_begins_inside_the_artefact_is_not_proved(self, in_directory: Path) -> None:
        """The proof sees where the machine stands and how the mount is turned."""
        settings, _ = prepare_case(in_directory)
        job = prepare_job(settings, in_directory)
        position = SequentialCandidates(job).positions[0]
        proof = sequential._Proof(job, (position,), 1, standing_in(position))
        inside = point(job.layout.nominal(position)[5])
        assert proof.minutes(job.start_mm, lambda: None) > 0.0
        assert proof.minutes(inside, lambda: None) < 0.0

    def test_a_run_without_any_measured_position_ends_before_the_held_out_ones(
        self, in_directory: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(sequential._Proof, "minutes", lambda *_: -1.0)
        settings, machine = prepare_case(in_directory)
        ended = machine.run(settings, kind=REACHING)
        assert isinstance(ended.error, GateRefused)
        assert "no position was measured" in str(ended.error)
        assert ended.outcome.state is RunState.REFUSED
        assert not recorded(in_directory, "held-out/")

    def test_a_position_whose_balls_are_out_of_reach_falls_out(
        self, in_directory: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The mount stands elsewhere than its settings say, and the balls of a proved position leave the travel."""
        gone: list[str] = []

        def measure(order: MeasuringOrder, *arguments: object) -> Plan[MeasuredPositions]:
            if order.prefix == "measure-2":
                name = position_key(order.positions[0])
                gone.append(name)
                yield Record(f"{order.prefix}/{name}/left-out", "event", {"reachable_balls": 2})
                return MeasuredPositions((), (name,), 9, order.standing_at, arguments[2])  # type: ignore[arg-type]
            return (yield from measure_positions(order, *arguments))  # type: ignore[arg-type]

        monkeypatch.setattr(sequential, "measure_positions", measure)
        settings, machine = prepare_case(in_directory)
        ended = machine.run(settings, kind=REACHING)
        assert ended.error is None, ended.error
        keys = [key for key, _ in recorded(in_directory, "measure-")]
        assert len(set(gone)) == 1 and not any(f"/{gone[0]}/" in key for key in keys)
        assert any(key.startswith("measure-2-1/station-") for key in keys)

    def test_a_slot_that_is_too_short_is_refused_with_the_time_that_it_takes(self, in_directory: Path) -> None:
        settings, machine = prepare_case(in_directory)
        ended = machine.run(settings, kind=replace(KIND, slot_minutes=10.0))
        assert isinstance(ended.error, PlanRefused)
        assert "the slot of 10 min is too short: 6 positions" in str(ended.error)
        assert ended.outcome.state is RunState.REFUSED


class TestRepeats:
    """The machine counts as changed, so that positions are measured again before the proof."""

    @staticmethod
    def run(directory: Path) -> tuple[RunResult, list[str]]:
        settings, machine = prepare_case(directory)
        temperature = settings.temperature.model_copy(update={"repeat_after_change_k": 0.0})
        ended = machine.run(settings.model_copy(update={"temperature": temperature}), kind=REACHING)
        return ended, [key for key, _ in recorded(directory)]

    def test_they_are_proved_before_anything_moves(self, in_directory: Path) -> None:
        ended, keys = self.run(in_directory)
        assert ended.error is None, ended.error
        close = next(place for place, key in enumerate(keys) if key.startswith("close/station-"))
        assert keys.index("sequential/proof-repeat") < close

    def test_they_are_left_out_if_they_cannot_be_measured(
        self, in_directory: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        proved = sequential._Proof.minutes

        def minutes(self: sequential._Proof, *arguments: object) -> float:
            return proved(self, *arguments) if self.held_out_follows else -1.0  # type: ignore[arg-type]

        monkeypatch.setattr(sequential._Proof, "minutes", minutes)
        ended, keys = self.run(in_directory)
        assert ended.error is None, ended.error
        assert "sequential/proof-repeat" in keys
        assert not any(key.startswith("close/station-") for key in keys)


def test_a_target_that_is_reached_ends_the_run_before_its_slot(reaching: tuple) -> None:
    directory, _, _, ended = reaching
    assert ended.error is None, ended.error
    [*chosen, end] = choices(directory)
    last = dict(recorded(directory, "sequential/posterior-"))[f"sequential/posterior-{len(chosen)}"]
    assert end == STOP
    assert len(chosen) == MIN_POSITIONS
    assert last["reached"]  # type: ignore[index]
    with open_journal(directory / STATE) as reader:
        [row] = reader.runs()
        notes = [str(event.record.get("note", "")) for event in reader.events(row.run)]
    assert any(note.startswith("6 positions: the upper limit of the VCE, ") for note in notes)
    stated = ended.outcome.as_json()["predicted_vce_limits_um"]
    assert last["limits_um"] == pytest.approx(stated)  # type: ignore[index]
