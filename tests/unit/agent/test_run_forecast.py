"""Forecast of a run on a controller that is slower than the settings state."""

import dataclasses

import pytest

from agent.execution.engine import Engine
from agent.execution.steps import Record, Step
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import expected_plan
from agent.planning.ideal_machine import IdealMachine
from agent.planning.latency_fit import MOVE, TOUCH, TURN
from agent.planning.run_minutes import MEASURING, PHASES, VERIFICATION
from agent.planning.run_phases import PROBE_CHECK, QUALIFICATION, REVERSAL
from agent.planning.time_model import time_model
from agent.runs.kinds.calibrate import calibration_of, preflight_of
from agent.runs.run_forecast import RunForecast
from drivers.clock import VirtualClock
from twin.units import S_PER_MIN

SLOW_S = {MOVE: 0.05, TOUCH: 0.21, TURN: 1.5}


def test_the_minutes_left_follow_the_controller_from_the_second_position_on() -> None:
    job = load_case(CASE_STUDY)
    model = time_model(job.machine, job.settings.timing)
    slow = dataclasses.replace(
        model, command_latency_s=SLOW_S[MOVE], touch_latency_s=SLOW_S[TOUCH], turn_latency_s=SLOW_S[TURN]
    )
    forecast, clock = RunForecast(preflight_of(job), model, job.held_out), VirtualClock()
    machine = IdealMachine(job.layout, slow, job.start_mm, lambda _, motion_s, rest_s: clock.sleep(motion_s + rest_s))
    said: list[tuple[float, float]] = []
    last_s = 0.0

    def observe(step: Step, result: object) -> None:
        nonlocal last_s
        forecast.observe(step, result, clock.now() - last_s)
        last_s = clock.now()
        progress = forecast.progress(step.key)
        if isinstance(step, Record) and step.kind == "ball" and progress is not None:
            said.append((clock.now(), S_PER_MIN * progress.minutes_left))

    at_first = forecast.at_start()
    Engine(machine.actions(), observer=observe).run(expected_plan(calibration_of(job)))
    took_s = clock.now()
    assert at_first is not None
    assert S_PER_MIN * at_first.minutes_left < 0.9 * took_s
    after_three = said[33:]  # eleven balls a position
    assert len(after_three) > 200
    assert [now + left for now, left in after_three] == pytest.approx([took_s] * len(after_three), rel=0.005)

    told = forecast.run_time(took_s / S_PER_MIN)
    assert {one.kind: one.learned_s for one in told.latencies if one.kind in SLOW_S} == pytest.approx(SLOW_S, abs=1e-6)
    assert f"forecast 64.3 min, took {took_s / S_PER_MIN:.1f}: waiting for the controller" in told.text
    assert "0.21 s a touch instead of 0.079" in told.text
    assert tuple(told.by_phase) == PHASES
    assert sum(told.by_phase.values()) == pytest.approx(told.minutes)
    assert sum(told.forecast_by_phase.values()) == pytest.approx(told.forecast_minutes)
    assert told.by_phase[MEASURING] > told.forecast_by_phase[MEASURING] > told.forecast_by_phase[VERIFICATION]


def test_a_run_as_forecast_gives_no_cause() -> None:
    job = load_case(CASE_STUDY)
    preflight = preflight_of(job)
    forecast = RunForecast(preflight, time_model(job.machine, job.settings.timing), job.held_out)
    told = forecast.run_time(preflight.machine_minutes)
    assert told.text == "forecast 64.3 min, took 64.3"
    assert forecast.progress("no/such/step") is None


def test_each_phase_goes_on_from_its_first_step_to_its_end() -> None:
    job = load_case(CASE_STUDY)
    preflight = preflight_of(job)
    forecast = RunForecast(preflight, time_model(job.machine, job.settings.timing), job.held_out)
    before = forecast.at_start()
    assert before is not None
    assert (before.phase, before.fraction, before.phase_fraction) == (PROBE_CHECK, 0.0, 0.0)
    assert before.minutes_left == pytest.approx(preflight.machine_minutes)

    said = [before]
    for key in preflight.timeline:
        progress = forecast.progress(key)
        assert progress is not None
        said.append(progress)
    assert [one.minutes_left for one in said] == sorted((one.minutes_left for one in said), reverse=True)
    assert [one.fraction for one in said] == sorted(one.fraction for one in said)
    assert (said[-1].fraction, said[-1].minutes_left) == (1.0, 0.0)
    phases = {one.phase: [other for other in said if other.phase == one.phase] for one in said}
    assert list(phases) == [PROBE_CHECK, QUALIFICATION, REVERSAL, MEASURING, VERIFICATION]
    for own in phases.values():
        fractions = [one.phase_fraction for one in own]
        assert fractions == sorted(fractions)
        assert fractions[0] < 0.05
        assert fractions[-1] > 0.8  # the end of its last step is the beginning of the next phase
        assert len(set(fractions)) > 10
    qualifying = sum(timed.seconds for timed in preflight.steps if "/qualify/" in timed.step.key)
    first = phases[QUALIFICATION][0]
    assert first.phase_minutes_left == pytest.approx(qualifying / S_PER_MIN, rel=0.1)
    balls_before = [key for key in preflight.timeline if key.startswith("measure/") and key.endswith("/centre")]
    assert list(preflight.timeline).index(balls_before[0]) > 200  # all of it before the first measured ball


def test_a_run_on_another_way_than_expected_is_followed_to_its_end() -> None:
    job = load_case(CASE_STUDY)
    preflight = preflight_of(job, every_branch=True)
    model = time_model(job.machine, job.settings.timing)
    longest = max(preflight.ends, key=lambda branch: branch.machine_seconds)
    assert longest.machine_seconds > preflight.expected.machine_seconds + S_PER_MIN
    forecast = RunForecast(preflight, model, job.held_out)
    assert all(forecast.progress(key) is not None for key in longest.timeline)
    key = next(key for key in longest.timeline if key not in preflight.timeline)
    forecast = RunForecast(preflight, model, job.held_out)
    assert forecast.progress("state/measuring") is not None
    progress = forecast.progress(key)
    assert progress is not None
    assert progress.minutes_left == pytest.approx((longest.machine_seconds - longest.timeline[key]) / S_PER_MIN)
