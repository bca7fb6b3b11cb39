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
        left_s = forecast.left_s(step.key)
        if isinstance(step, Record) and step.kind == "ball" and left_s is not None:
            said.append((clock.now(), left_s))

    at_first_s = forecast.left_s(next(iter(preflight_of(job).timeline)))
    Engine(machine.actions(), observer=observe).run(expected_plan(calibration_of(job)))
    took_s = clock.now()
    assert at_first_s is not None
    assert at_first_s < 0.9 * took_s
    after_three = said[33:]  # eleven balls a position
    assert len(after_three) > 200
    assert [now + left for now, left in after_three] == pytest.approx([took_s] * len(after_three), rel=0.005)

    told = forecast.run_time(took_s / S_PER_MIN)
    assert {one.kind: one.learned_s for one in told.latencies if one.kind in SLOW_S} == pytest.approx(SLOW_S, abs=1e-6)
    assert f"forecast 64.6 min, took {took_s / S_PER_MIN:.1f}: waiting for the controller" in told.text
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
    assert told.text == "forecast 64.6 min, took 64.6"
    assert forecast.left_s("no/such/step") is None
