"""Latencies recovered from a finished run: from synthetic steps and from a journal."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from volcal_command import volcal, volcal_json

from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.journal_rows import StepRow
from agent.execution.run_record import read_steps
from agent.planning.case_file import CASE_STUDY
from agent.planning.ideal_machine import IdealMachine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.latency_fit import (
    CARRY,
    MOVE,
    TOUCH,
    TURN,
    ObservedStep,
    observed_steps,
    refit,
    step_kind_timings,
    suggested_settings,
)
from agent.planning.time_model import TimeModel, time_model
from agent.probing.run_plan import MeasuringOrder, measure_positions
from agent.settings.load import load_settings
from drivers.clock import VirtualClock
from drivers.errors import InputError
from drivers.roles import OperatorTask

MODEL = TimeModel(
    rapid_mm_per_s=(100.0, 50.0, 100.0),
    acceleration_mm_per_s2=(50.0, 50.0, 50.0),
    turn_deg_per_s=20.0,
    turn_deg_per_s2=40.0,
    command_latency_s=0.25,
    touch_latency_s=0.5,
    turn_latency_s=2.0,
    carrying_s=300.0,
)


def case_study_job() -> Job:
    return prepare_job(load_settings(CASE_STUDY), CASE_STUDY.parent)


def test_latencies_are_found_again_whatever_motion_they_are_on_top_of() -> None:
    rng = np.random.default_rng(5)
    truth = {MOVE: 0.03, TOUCH: 0.2, TURN: 0.7}
    observed = [
        ObservedStep(kind, motion, motion + latency + float(rng.normal(0.0, 0.01)))
        for kind, latency in truth.items()
        for motion in rng.uniform(0.1, 9.0, 400).tolist()
    ]
    fitted = refit(MODEL, observed)
    found = np.array([fitted.command_latency_s, fitted.touch_latency_s, fitted.turn_latency_s])
    assert found == pytest.approx(np.array(list(truth.values())), abs=4 * 0.01 / 20)
    # numpy's least squares on the same data, one column of ones a kind
    columns = np.array([[step.kind == kind for kind in truth] for step in observed], dtype=float)
    beyond = np.array([step.observed_s - step.motion_s for step in observed])
    assert found == pytest.approx(np.linalg.lstsq(columns, beyond, rcond=None)[0])
    assert dataclasses.replace(fitted, command_latency_s=0.25, touch_latency_s=0.5, turn_latency_s=2.0) == MODEL
    assert [kind.rest_s for kind in step_kind_timings(MODEL, observed)] == pytest.approx([0.01] * 3, rel=0.1)


def test_a_machine_quicker_than_its_file_gets_no_negative_latency() -> None:
    assert refit(MODEL, [ObservedStep(MOVE, 2.0, 1.5)]).command_latency_s == 0.0


def journaled(kind: str, begun_s: float, finished_s: float | None, result: object = None, **detail: object) -> StepRow:
    result_text = None if result is None else json.dumps(result)
    return StepRow(1, "k", kind, json.dumps(detail), begun_s, finished_s, result_text, None)


def test_a_replay_knows_where_the_axes_stand() -> None:
    steps = [
        journaled(MOVE, 0.0, 9.0, target_mm=[5.0, 0.0, 0.0], feed_mm_per_s=None),  # from nobody knows where
        journaled("ReadPosition", 9.0, 9.0, [0.0, 0.0, 0.0]),
        journaled(MOVE, 9.0, 16.5, target_mm=[0.0, 300.0, 0.0], feed_mm_per_s=None),
        journaled(TOUCH, 20.0, 23.0, {"touch": [20.0, 300.0, 0.0]}, target_mm=[30.0, 300.0, 0.0], feed_mm_per_s=10.0),
        journaled(MOVE, 23.0, 24.0, target_mm=[21.0, 300.0, 0.0], feed_mm_per_s=None),  # where the touch came to rest
        journaled(MOVE, 24.0, None, target_mm=[900.0, 300.0, 0.0], feed_mm_per_s=None),  # broken off
        journaled(MOVE, 30.0, 31.0, target_mm=[0.0, 0.0, 0.0], feed_mm_per_s=None),
        journaled(TURN, 31.0, 32.0, azimuth_deg=0.0, elevation_deg=30.0),
        journaled(TURN, 32.0, 39.0, azimuth_deg=-90.0, elevation_deg=60.0),
        journaled(CARRY, 39.0, 99.0, request={"task": OperatorTask.MOVE_ARTEFACT.value, "station": 2}),
        journaled(CARRY, 99.0, 100.0, request={"task": OperatorTask.CONSENT.value, "station": None}),
    ]
    observed = observed_steps(steps, MODEL)
    assert [(step.kind, step.observed_s) for step in observed] == [
        (MOVE, 7.5), (TOUCH, 3.0), (MOVE, 1.0), (TURN, 7.0), (CARRY, 60.0),
    ]  # fmt: skip
    assert [step.motion_s for step in observed] == pytest.approx([7.0, 2.3, 0.0, 5.0, 0.0], abs=1e-9)
    assert suggested_settings(refit(MODEL, observed)) == {
        "command_latency_s": 0.75,
        "touch_latency_s": 0.7,
        "turn_latency_s": 2.0,
        "relocation_minutes": 1.0,
    }


@pytest.fixture(scope="module")
def slow_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One position on a machine that takes 20 ms a move, 0.1 s a touch, 0.6 s a turn and 90 s a carrying."""
    fast = case_study_job()
    clock = VirtualClock()
    slow = dataclasses.replace(
        time_model(fast.machine, fast.settings.timing),
        command_latency_s=0.02,
        touch_latency_s=0.1,
        turn_latency_s=0.6,
        carrying_s=90.0,
    )
    machine = IdealMachine(
        fast.layout, slow, (0.0, 0.0, 0.0), lambda _, motion_s, rest_s: clock.sleep(motion_s + rest_s)
    )
    folder = tmp_path_factory.mktemp("runs")
    journal = Journal(folder)
    run = journal.start_run("slow", "calibrate", fast.settings.model_dump(mode="json"), "0", clock)
    order = MeasuringOrder("measure", fast.positions[:2], None)
    Engine(machine.actions(), run).run(measure_positions(order, fast.layout, fast.rules))
    journal.close()
    return folder / "slow"


def test_the_command_finds_what_a_run_took(slow_run: Path) -> None:
    said = volcal_json("timing", slow_run)
    assert said["timing"] == {
        "command_latency_s": 0.02,
        "touch_latency_s": 0.1,
        "turn_latency_s": 0.6,
        "relocation_minutes": 1.5,
    }
    kinds = {kind["kind"]: kind for kind in said["steps"]}
    located, positions, balls_and_the_first_again = 1, 2, 11 + 1
    touches = 5 * (located + positions * balls_and_the_first_again)
    assert kinds[TOUCH]["count"] == touches
    assert kinds[TOUCH]["latency_s"] == 0.079
    assert kinds[TOUCH]["observed_s"] - kinds[TOUCH]["predicted_s"] == pytest.approx(touches * (0.1 - 0.079))
    assert max(kind["rest_s"] for kind in kinds.values()) < 1e-9


def test_the_command_prints_what_to_write_into_the_settings(slow_run: Path) -> None:
    done = volcal("timing", slow_run)
    assert done.stdout.endswith(
        "[timing]\ncommand_latency_s = 0.02\ntouch_latency_s = 0.1\nturn_latency_s = 0.6\nrelocation_minutes = 1.5\n"
    )


def test_only_a_run_that_is_there_is_read(slow_run: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no run other.*the last ones are: slow"):
        read_steps(slow_run.parent, "other")
    nowhere = tmp_path / "nowhere"
    with pytest.raises(InputError, match="there is no journal"):
        read_steps(nowhere, "slow")
    assert not nowhere.exists()
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "journal.sqlite").write_bytes(b"no database" * 100)
    with pytest.raises(InputError, match="cannot be read"):
        read_steps(tmp_path / "torn", "slow")


def test_a_run_without_steps_teaches_nothing(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.start_run("idle", "calibrate", case_study_job().settings.model_dump(mode="json"), "0", VirtualClock())
    journal.close()
    done = volcal("timing", tmp_path / "idle", exit_code=2)
    assert "no step from which latencies can be derived" in done.output
