"""Waiting until the artefact has settled, and closing the loop over a run: as plans, answered by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from agent.errors import MeasurementFault, ThermometerFault
from agent.execution import steps as s
from agent.settings.temperature import TemperatureSettings
from agent.thermal.position_drift import DriftLimits, judge_drift
from agent.thermal.readings import Conditions, Thermometers, rate_k_per_h
from agent.thermal.settling import SettlingRules, read_conditions, wait_until_settled

RULES = SettlingRules(max_rate_k_per_h=5.0, max_departure_k=4.0, poll_interval_s=60.0, deadline_s=1800.0)


def played(
    plan: s.Plan[Any], bar_c: Callable[[float], float | None], waited_s: Mapping[str, float] | None = None
) -> tuple[list[s.Step], Any]:
    """Steps and conclusion; time passes in dwells alone, which last as long as they say or as `waited_s` says."""
    now = 0.0
    seen: list[s.Step] = []
    answer: Any = None
    try:
        while True:
            step = plan.send(answer)
            seen.append(step)
            match step:
                case s.ReadTemperatures():
                    value = bar_c(now)
                    answer = {} if value is None else {"artefact": value}
                    step.require(answer, now)
                case s.ReadClock():
                    answer = now
                case s.Dwell():
                    now, answer = now + (waited_s or {}).get(step.key, step.duration_s), None
                case _:
                    answer = None
    except StopIteration as stop:
        return seen, stop.value


def test_a_settled_artefact_costs_no_time_and_no_event() -> None:
    seen, conditions = played(wait_until_settled("measure/station-1/az0-el0", RULES, ()), lambda _: 20.3)
    assert [type(step) for step in seen] == [s.ReadTemperatures, s.ReadClock]
    assert conditions == Conditions(0.0, 20.3)


def test_a_run_waits_for_an_artefact_that_is_too_warm_and_says_why() -> None:
    seen, conditions = played(wait_until_settled("k", RULES, ()), lambda now: 20.0 + 6.0 * np.exp(-now / 900.0))
    told = [step for step in seen if isinstance(step, s.Record)]
    assert len(told) == 1
    assert told[0].payload["note"].startswith("waiting until the artefact has settled: the artefact has 26.00 °C")
    assert abs(conditions.artefact_c - 20.0) <= 4.0
    # settled in temperature after 365 s; its rate falls below 5 K/h at 900 ln(4.8)
    assert conditions.instant_s == pytest.approx(900.0 * np.log(4.8) + 300.0, abs=310.0)
    assert len({step.key for step in seen}) == len(seen)


@pytest.mark.parametrize(("before_s", "before_c"), [(-60.0, 18.9), (-60.0, 21.8), (-3600.0, 14.2)])
def test_a_thermometer_that_jumps_is_read_again_and_ends_the_run_at_a_step_without_a_result(
    before_s: float, before_c: float
) -> None:
    plan = wait_until_settled("measure/station-1/az0-el0", RULES, [Conditions(before_s, before_c)])
    with pytest.raises(ThermometerFault, match=f"jumped from {before_c:.2f} to 20.30 °C.*read 3 times more") as caught:
        played(plan, lambda _: 20.3)
    assert caught.value.where["step"] == "measure/station-1/az0-el0/read-again-3"


def wild_until(end_s: float, wild_c: float | None) -> Callable[[float], float | None]:
    return lambda now: wild_c if now < end_s else 20.3


@pytest.mark.parametrize("wild_c", [85.0, -127.0, 0.0, None])
@pytest.mark.parametrize(("end_s", "not_used"), [(1.0, 1), (6.0, 2), (15.0, 3)])
def test_a_reading_in_doubt_is_replaced_by_one_that_agrees_with_the_former_and_noted(
    wild_c: float | None, end_s: float, not_used: int
) -> None:
    seen, found = played(read_conditions("b", RULES, Conditions(-10.0, 20.2)), wild_until(end_s, wild_c))
    assert found == Conditions(5.0 * not_used, 20.3)
    *rejected, note = [dict(step.payload) for step in seen if isinstance(step, s.Record)]
    read = [step.key for step in seen if isinstance(step, s.ReadTemperatures)]
    assert [one["rejected"] for one in rejected] == read[:-1]
    assert all(one["reason"] in note["note"] for one in rejected[:1])
    assert note["readings_not_used"] == not_used
    assert ("no reading of artefact" if wild_c is None else f"to {wild_c:.2f} °C") in note["note"]
    assert len({step.key for step in seen}) == len(seen)


@pytest.mark.parametrize("before", [None, Conditions(-10.0, 20.2)])
def test_a_thermometer_that_stays_silent_ends_the_run_at_a_step_without_a_result(before: Conditions | None) -> None:
    with pytest.raises(ThermometerFault, match="no reading of artefact"):
        played(read_conditions("b", RULES, before), lambda _: None)


def test_a_thermometer_that_agrees_again_when_the_run_is_resumed_hours_later_is_used() -> None:
    """The last reading is judged at the time at which it is made, and the artefact may have changed until then."""
    plan = read_conditions("b", RULES, Conditions(-10.0, 20.2))
    _, found = played(plan, wild_until(15.0 + 1.0, 85.0), waited_s={"b/read-again-3/wait": 7200.0})
    assert found == Conditions(7210.0, 20.3)


@pytest.mark.parametrize(("before_s", "before_c"), [(-10.0, 19.4), (-3600.0, 14.4), (-8.0 * 3600.0, 24.0)])
def test_a_change_that_an_artefact_can_make_is_no_doubt(before_s: float, before_c: float) -> None:
    assert RULES.doubt(Conditions(before_s, before_c), {"artefact": 20.3}, 0.0) == ""


def test_at_the_deadline_it_gives_up_and_says_what_to_do() -> None:
    with pytest.raises(MeasurementFault, match=r"has not settled within 30 min.*26\.00 °C") as caught:
        played(wait_until_settled("k", RULES, ()), lambda _: 26.0)
    assert "leave the artefact on the table" in str(caught.value)


def test_the_rate_is_judged_over_the_readings_of_the_position_before() -> None:
    before = [Conditions(-10.0 * k, 20.0 - 0.02 * k) for k in range(12, 0, -1)]  # 7.2 K/h
    seen, _ = played(wait_until_settled("k", RULES, before), lambda now: 20.0)
    assert any(isinstance(step, s.Dwell) for step in seen)
    slow = [Conditions(-10.0 * k, 20.0 - 0.01 * k) for k in range(12, 0, -1)]
    assert not any(
        isinstance(step, s.Dwell) for step in played(wait_until_settled("k", RULES, slow), lambda _: 20.0)[0]
    )


def test_rate_is_the_slope_of_a_straight_line() -> None:
    seconds, rng = np.arange(0.0, 600.0, 10.0), np.random.default_rng(1)
    values = 21.0 + 3.0 * seconds / 3600.0 + 0.01 * rng.standard_normal(len(seconds))
    found = rate_k_per_h([Conditions(a, b) for a, b in zip(seconds.tolist(), values.tolist(), strict=True)])
    assert found == pytest.approx(3600.0 * np.polyfit(seconds, values, 1)[0])
    assert rate_k_per_h([Conditions(1.0, 20.0)]) is None
    assert rate_k_per_h([Conditions(1.0, 20.0), Conditions(1.0, 21.0)]) is None


def test_several_thermometers_are_averaged_and_a_silent_one_is_named() -> None:
    two = Thermometers(artefact=("artefact", "artefact-2"), machine=("column", "bed"))
    assert two.artefact_c({"artefact": 20.0, "artefact-2": 20.5}) == 20.25
    assert two.machine_c({"bed": 22.0}) == 22.0
    assert two.machine_c({}) is None
    with pytest.raises(MeasurementFault, match="no reading of artefact-2; readings: artefact"):
        two.artefact_c({"artefact": 20.0})
    assert Thermometers(declared_artefact_c=21.5).artefact_c({}) == 21.5


def test_a_declared_temperature_needs_its_uncertainty_and_must_be_near_enough() -> None:
    with pytest.raises(ValueError, match="requires standard_uncertainty_k greater than 0"):
        TemperatureSettings(declared_artefact_c=21.0)
    with pytest.raises(ValueError, match="no run could start"):
        TemperatureSettings(declared_artefact_c=35.0, standard_uncertainty_k=0.5)
    assert TemperatureSettings(declared_artefact_c=21.0, standard_uncertainty_k=0.5).declared_artefact_c == 21.0


@pytest.mark.parametrize(("um", "notes", "ends"), [(2.0, False, False), (7.0, True, False), (11.0, True, True)])
def test_a_drift_is_told_above_one_limit_and_a_fault_above_another(um: float, notes: bool, ends: bool) -> None:
    seen: list[s.Step] = []
    plan = judge_drift("k/again", np.array([0.0, 1e-3 * um, 0.0]), DriftLimits(5e-3, 10e-3))
    try:
        for step in plan:
            seen.append(step)
        ended = False
    except MeasurementFault as fault:
        ended = True
        assert "11.0 µm" in str(fault)
    record = seen[0]
    assert isinstance(record, s.Record)
    assert ("note" in record.payload) is notes
    assert ended is ends
