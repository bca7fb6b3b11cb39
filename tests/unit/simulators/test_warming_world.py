"""Temperatures and thermal effects, compared with a stepwise solution of the differential equation
and plain geometry.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import TOOL, World, case_study

from simulators.temperatures import ThermalSettings
from simulators.world.thermal_effects import ThermalEffects, bend_balls
from simulators.world.thermal_state import ThermalState, first_order_response

RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))


@pytest.mark.parametrize(("source", "follower"), [(0.0, 0.4), (0.3, 0.0), (0.3, 0.8), (0.5, 0.5), (0.5, 0.5 + 1e-9)])
def test_a_follower_answers_as_its_differential_equation_does(source: float, follower: float) -> None:
    step, level = 1e-4, 0.0
    for k in range(15_000):
        hours = (k + 0.5) * step
        target = 1.0 - np.exp(-hours / source) if source else 1.0
        level = target if follower == 0.0 else level + step * (target - level) / follower
    assert first_order_response(1.5, source, follower) == pytest.approx(level, abs=2e-4)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.floats(0.0, 20.0))
def test_an_answer_lies_between_nothing_and_all(source: float, follower: float, hours: float) -> None:
    assert -1e-9 <= first_order_response(hours, source, follower) <= 1.0 + 1e-9


def test_nothing_warms_without_any_key() -> None:
    thermal = ThermalEffects(ThermalSettings(artefact_c=20.5, machine_c=21.0, ambient_c=20.8), RANGES)
    assert thermal.temperatures_c(7200.0) == {"artefact": 20.5, "machine": 21.0, "ambient": 20.8}
    assert thermal.drift_mm(7200.0) == (0.0, 0.0, 0.0)
    assert thermal.field(7200.0) is None


def test_bodies_follow_the_air_with_lags_of_their_own_and_stick() -> None:
    settings = ThermalSettings(
        ambient_rise_k=6.0, body_time_constants_h={"ram": 0.5, "bed": 8.0}, sensor_stuck_after_h={"ram": 2.0}
    )
    thermal = ThermalEffects(settings, RANGES)
    for hours in (1.0, 2.0, 5.0):
        found = thermal.temperatures_c(3600.0 * hours)
        assert found["bed"] == pytest.approx(26.0 - 6.0 * np.exp(-hours / 8.0))
        assert found["ram"] == pytest.approx(26.0 - 6.0 * np.exp(-min(hours, 2.0) / 0.5))
        assert found["machine"] == 20.0


@pytest.mark.parametrize("name", ["machine", "artefact-2", "Ram", ""])
def test_a_body_has_a_name_of_its_own(name: str) -> None:
    with pytest.raises(ValueError, match="body_time_constants_h"):
        ThermalSettings(body_time_constants_h={name: 1.0})


def test_scales_stretch_about_zero_and_the_column_tilts_what_it_carries() -> None:
    settings = ThermalSettings(
        machine_k_per_h=2.0, scale_um_per_m_k=(8.0, 9.0, 10.0), bend_um_per_k=5.0, growth_um_per_k=(1.0, 0.0, -2.0)
    )
    thermal = ThermalEffects(settings, RANGES, (0.0, 250.0, 0.0))
    field = thermal.field(5400.0)  # 3 K
    assert field is not None
    origin, far = field(np.array([[0.0, 0.0, 0.0], [4000.0, 1000.0, 1500.0]]))
    assert origin == pytest.approx([0.0, 0.0, 0.0])
    tilt = 2.0 * 0.015 / 1500.0
    assert far == pytest.approx([0.096, 0.027 + 0.015, 0.045 - tilt * 1250.0])
    assert thermal.drift_mm(5400.0) == pytest.approx((0.003, 0.0, -0.006))


def test_thermometers_err_lag_and_scatter_and_several_stand_on_the_bar() -> None:
    settings = ThermalSettings(
        artefact_k_per_h=6.0, artefact_sensors=2, sensor_offset_k={"artefact-2": 0.4}, sensor_lag_s=60.0
    )
    told = ThermalEffects(settings, RANGES).temperatures_c(3600.0)
    assert told["artefact"] == pytest.approx(25.9)
    assert told["artefact-2"] == pytest.approx(26.3)
    noisy = ThermalEffects(settings.model_copy(update={"sensor_noise_k": 0.02}), RANGES, seed=3)
    errors = np.array([noisy.temperatures_c(s)["ambient"] - 20.0 for s in range(1000)])
    assert errors.std() == pytest.approx(0.02, rel=0.1)
    assert abs(errors.mean()) < 0.003
    assert noisy.temperatures_c(17.0) == noisy.temperatures_c(17.0)


def test_the_bar_follows_the_ambient_and_bows_while_it_is_behind() -> None:
    settings = ThermalSettings(ambient_rise_k=3.0, artefact_time_constant_h=0.5)
    warming = ThermalState(settings)
    assert warming.artefact_c(1800.0) == pytest.approx(20.0 + 3.0 * (1.0 - np.exp(-1.0)))
    assert warming.artefact_lag_k(0.001) == pytest.approx(3.0, abs=0.01)
    balls = np.array([[-750.0, 0.0, 0.0], [0.0, 0.0, 5.0], [750.0, 1.0, 0.0]])
    assert bend_balls(balls, 0.002) - balls == pytest.approx(np.array([[0, 0, 0], [0, 0, 0.002], [0, 0, 0]]))


def test_the_truth_is_that_of_the_machine_as_warm_as_it_is() -> None:
    scenario = case_study()
    warm = ThermalSettings(machine_k_per_h=3.0, scale_um_per_m_k=(8.0, 8.0, 8.0))
    world = World(
        type(scenario)(scenario.settings.model_copy(update={"temperatures": warm}), scenario.machine, scenario.artefact)
    )
    cold = world.truth.true_volumetric_error()[1]
    world.advance_to(3600.0)
    at = np.array([1234.0, 567.0, 890.0])
    world.controller.begin_move(at, None, guarded=False)
    tip = np.array(world.controller.contacts.tip(tuple(at)))
    own = world.truth.machine.deviation(at[None])[0]
    play = np.array(world.controller._shift.rigid)
    assert tip - at - TOOL - own - play == pytest.approx(24e-6 * at, abs=1e-9)
    assert world.truth.true_volumetric_error()[1] > 2.0 * cold
