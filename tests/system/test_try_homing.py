"""The scatter of the homing on a simulated machine whose zero is displaced by each homing: measured by a trial, and
counted by the runs after it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nights import Night, short_document
from stored_run import stored_run
from test_hand_placed import document as hand_placed
from test_try_command import scenario

from agent.errors import PlanRefused
from agent.execution.rig import Rig
from agent.execution.run_record import read_record
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.results.decision_kinds import OUTCOME, TRIAL
from agent.runs.kinds.trial import OneBallTrial, with_checks
from agent.runs.kinds.verify import Verification
from agent.runs.last_homing import after_homing, last_homing
from agent.runs.resume.resume import resume
from agent.runs.session import RunResult
from agent.runs.unfinished_run import unfinished_run
from agent.settings.schema import Settings
from drivers.errors import LinkLost, MotionFault, VolcalError
from simulators.backend import SimulatedMachineDevice
from simulators.world.noise import NoiseSource

SIGMA_UM = (20.0, 4.0, 10.0)
HOMINGS = 6


def homed(state: Path, night: Night, homings: int = HOMINGS, **scenario_sections: Any) -> RunResult:
    """Carry out a trial with homings on a machine whose zero scatters."""
    sections = {"axes": {"homing_um": SIGMA_UM}, **scenario_sections}
    devices = {"twin": {"driver": "simulated", "options": scenario(**sections)}}
    document = with_checks(Settings.model_validate(short_document(state, devices=devices)))
    return night.run(document.model_dump(), files=False, kind=OneBallTrial(homings=homings))


def prepared(document: dict[str, Any]) -> Job:
    return prepare_job(Settings.model_validate(document), Path.cwd())


def test_a_trial_measures_the_scatter_of_each_axis_and_leaves_mount_and_store_alone(state: Path) -> None:
    night = Night()
    done = homed(state, night)
    assert done.error is None, done.error
    assert done.outcome.state is RunState.COMPLETE
    assert night.world is not None
    assert night.world.collisions == []
    assert (night.world.controller.banks, night.world.controller.active_bank) == ({}, 0)
    trial = done.outcome.trial
    assert trial is not None
    assert trial.homing is not None
    homing = trial.homing
    assert homing.homings == HOMINGS
    # each homing displaces the ball against the display by what was drawn for it
    noise = NoiseSource(night.world.scenario.settings.seed, "homing")
    drawn = np.array([noise.normal(number) for number in range(1, HOMINGS + 1)]) * SIGMA_UM
    seen = np.array(homing.offsets_um)
    assert seen == pytest.approx(-(drawn - drawn.mean(axis=0)), abs=4.0)
    for sigma, (low, high), true in zip(homing.sigma_um, homing.limits_um, SIGMA_UM, strict=True):
        assert low <= true <= high
        assert low < sigma < high
    assert 0.2 < max(homing.touches_um) < 2.0
    # the time of the homings is part of the account of the run, and was forecast
    assert done.outcome.run_time is not None
    took = done.outcome.run_time.by_phase
    assert sum(took.values()) == pytest.approx(done.outcome.machine_minutes, rel=0.02)
    assert took["preparation"] == pytest.approx(done.outcome.run_time.forecast_by_phase["preparation"], rel=0.1)
    stored = read_record(state, done.outcome.run_id).decision(TRIAL)
    assert stored is not None
    assert stored["homing"] == trial.homing.as_json()


def test_without_scatter_only_an_upper_limit_of_the_size_of_the_touches_is_found(state: Path) -> None:
    done = homed(state, Night(), axes={"homing_um": 0.0})
    assert done.outcome.trial is not None
    homing = done.outcome.trial.homing
    assert homing is not None
    assert [low for low, _ in homing.limits_um] == [0.0, 0.0, 0.0]
    assert max(homing.sigma_um) < 2.0


def test_runs_count_the_scatter_of_the_last_trial_and_say_not_known_before(state: Path) -> None:
    night = Night()
    document = short_document(state)
    document["devices"]["twin"]["options"] |= {"axes": {"homing_um": SIGMA_UM}}
    before = night.run(document, files=False)
    assert before.error is None, before.error
    assert before.outcome.as_json()["after_homing"] is None
    tried = night.run(
        with_checks(Settings.model_validate(document)).model_dump(), kind=OneBallTrial(homings=HOMINGS), files=False
    )
    assert tried.error is None, tried.error
    measured = last_homing(state, prepared(document).machine.name)
    assert measured is not None
    assert measured.run_id == tried.outcome.run_id
    assert tried.outcome.trial is not None
    assert measured.scatter == tried.outcome.trial.homing
    assert last_homing(state, "another machine") is None

    verified = night.run(document, kind=Verification(), files=False)
    told = verified.outcome.as_json()["after_homing"]
    assert isinstance(told, dict)
    assert verified.outcome.night is not None
    assert told["run_id"] == tried.outcome.run_id
    assert told["ve_without_um"] == verified.outcome.night.ve_now_um
    assert told["offset_um"] == pytest.approx(np.linalg.norm(measured.scatter.sigma_um))
    # 1 µm/m of error and 20 µm of offset are far below a nanometre each
    assert 0.0 < told["field_um"] < 0.1
    assert told["ve_um"] == pytest.approx(np.hypot(told["ve_without_um"], told["field_um"]))
    stored = read_record(state, verified.outcome.run_id).decision(OUTCOME)
    assert stored is not None
    assert stored["after_homing"] == told
    planned = after_homing(prepared(document))
    assert planned is not None
    assert planned.field_um == pytest.approx(told["field_um"], rel=0.5)


def test_a_machine_that_cannot_be_homed_says_so_before_anything_moves(state: Path) -> None:
    def without_homing(rig: Rig) -> Rig:
        device = rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        device.why_no_homing = lambda: "the register map has no such command"  # type: ignore[method-assign]
        return rig

    night = Night(without_homing)
    done = homed(state, night)
    assert isinstance(done.error, PlanRefused)
    assert done.outcome.state is RunState.REFUSED
    assert "the register map has no such command" in str(done.error)
    assert night.world is not None
    assert night.world.controller.displayed_position() == pytest.approx(night.world.scenario.start_mm)


def test_a_homing_that_would_move_the_probe_into_the_artefact_is_refused(state: Path) -> None:
    """The stylus of the case study points towards the upper end of Y."""

    def homing_upwards(rig: Rig) -> Rig:
        device = rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        device.homing_directions = lambda: (1, 1, 1)  # type: ignore[method-assign]
        return rig

    night = Night(homing_upwards)
    done = homed(state, night)
    assert isinstance(done.error, PlanRefused)
    assert "Y homes at its upper end, to which the stylus points" in str(done.error)
    assert night.world is not None
    assert night.world.controller.displayed_position() == pytest.approx(night.world.scenario.start_mm)


def test_an_artefact_that_was_placed_by_hand_stays_where_it_stands(state: Path) -> None:
    placed = hand_placed(state)
    placed["devices"]["twin"]["options"]["axes"] = {"homing_um": SIGMA_UM}
    night = Night()
    settings = with_checks(Settings.model_validate(placed)).model_dump()
    done = night.run(settings, files=False, kind=OneBallTrial(homings=3))
    assert done.error is None, done.error
    assert night.world is not None
    assert night.world.collisions == []
    assert done.outcome.trial is not None
    assert done.outcome.trial.homing is not None
    assert all(
        low <= true <= high for (low, high), true in zip(done.outcome.trial.homing.limits_um, SIGMA_UM, strict=True)
    )
    run = stored_run(state)
    assert (len(run.steps_of("AskOperator")), len(run.steps_of("HomeAxes"))) == (1, 3)


@dataclass
class Failing:
    """Homing of a machine that is carried out `good` times and then fails with `error`."""

    good: int
    error: VolcalError
    calls: int = 0

    def tamper(self, rig: Rig) -> Rig:
        device = rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        home_axes = device.home_axes

        def home() -> None:
            self.calls += 1
            if self.calls > self.good:
                raise self.error
            home_axes()

        device.home_axes = home  # type: ignore[method-assign]
        return rig


def test_a_homing_that_fails_ends_the_trial_with_the_probe_at_its_safe_place(state: Path) -> None:
    failing = Failing(1, MotionFault("homing failed: homing found no switch (alarm 9)", hint="check the switches"))
    night = Night(failing.tamper)
    done = homed(state, night)
    assert done.outcome.state is RunState.FAULTED
    assert "homing found no switch" in str(done.error)
    assert "step homing/2/home" in str(done.error)
    assert night.world is not None
    assert night.world.collisions == []
    axis = 1  # of the stylus
    assert night.world.controller.displayed_position()[axis] == night.world.controller.limits().lower_mm[axis]
    assert last_homing(state, night.world.scenario.machine.name) is None


def test_an_interrupted_trial_with_homings_is_not_resumed(state: Path) -> None:
    night = Night(Failing(1, LinkLost("connection reset", link="127.0.0.1:502")).tamper)
    assert isinstance(homed(state, night).error, LinkLost)
    assert unfinished_run(state) is not None
    assert night.world is not None
    before = night.world.controller.displayed_position()
    resumed = resume(state, Night(world=night.world).hooks)
    assert isinstance(resumed.error, PlanRefused)
    assert "the axes may have been homed meanwhile" in str(resumed.error)
    assert night.world.controller.displayed_position() == pytest.approx(before)
