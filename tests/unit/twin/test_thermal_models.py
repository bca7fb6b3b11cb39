"""Machine that drifts during the measurement: the estimated drift, and the validity of its stated uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured, truth_of

from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification import Options, identify
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import evaluation_grid
from twin.thermal.growth_and_bending import DriftByThermometer, DriftByTime
from twin.thermal.machine_drift import DriftPrior
from twin.thermal.models import choose_model
from twin.thermal.readings import MachineTemperatures, smooth_readings

MODEL, FAMILY = case_study(3)
BAR = bar()
SCALES_PER_K = np.array([8e-6, 9e-6, 10e-6])
TIP_PER_K = np.array([0.002, 0.008, -0.005])
GRID = evaluation_grid(RANGES, (12, 6, 6))
WARMING = DriftByThermometer(DriftPrior())
PLAIN = Options(misfit_mm=0.0, estimate_scales=False, outliers="none")


def warmed(parameters: np.ndarray, rng: np.random.Generator, kelvin: float = 3.0) -> Observations:
    """Measure the whole set and some positions again at the end, by then on a machine `kelvin` warmer."""
    still = measured("S3", 3, BAR, lambda at, tool: exact_deviation(MODEL, at, tool, parameters), rng)
    again = still.select(still.position < 3)
    count = int(still.position.max()) + 1
    rows = {name: np.concatenate((getattr(still, name), getattr(again, name))) for name in ROWS}
    rows["position"] = np.concatenate((still.position, again.position + count))
    late = np.linspace(0.0, 1.0, len(rows["ball"]))
    course = kelvin * (1.0 - np.exp(-2.0 * late)) / (1.0 - np.exp(-2.0))
    at = rows["axis_positions"] + rng.normal(0.0, 1e-3, rows["axis_positions"].shape)
    at = at - course[:, None] * (at * SCALES_PER_K + TIP_PER_K)
    return Observations(
        **{**rows, "axis_positions": at}, tool_offsets=still.tool_offsets, thermal_regressors=course[:, None]
    )


ROWS = ("position", "ball", "tool", "axis_positions", "covariance", "temperature_c", "elevation_rad")


def left_um(parameters: np.ndarray, truth: np.ndarray, kelvin: float) -> float:
    """Return the rms of the remaining scale errors of X, Y, Z together on the grid, without rigid motions."""
    basis = deviation_basis(MODEL, GRID, TOOL)
    field = basis @ (truth - parameters) + kelvin * (GRID * SCALES_PER_K)
    along = field - field.mean(axis=0)
    middle = GRID - GRID.mean(axis=0)
    slopes = [float((along[:, i] * middle[:, i]).sum() / (middle[:, i] ** 2).sum()) for i in range(3)]
    return 1e3 * float(np.sqrt((np.square(middle * slopes)).sum(axis=1).mean()))


def test_the_estimate_is_that_of_the_machine_as_it_stands_at_the_end() -> None:
    rng = np.random.default_rng(1)
    truth = FAMILY.draw(rng, 1)[0]
    seen = warmed(truth, rng)
    blind = replace(seen.select(np.arange(seen.size)), thermal_regressors=np.zeros((seen.size, 0)))
    options = replace(PLAIN, drift=WARMING, state_regressors=seen.thermal_regressors[-1])
    found = identify(MODEL, seen, BAR, FAMILY, options)
    unaware = identify(MODEL, blind, BAR, FAMILY, PLAIN)
    assert left_um(found.parameters, truth, 3.0) < 4.0
    assert left_um(unaware.parameters, truth, 3.0) > 12.0
    assert found.drift is not None
    change = found.drift.change(seen.thermal_regressors[-1])
    for axis, (low, high) in enumerate(RANGES):
        value, doubt = change[f"E{'XYZ'[axis] * 2}[1]"]
        assert abs(value - 3.0 * SCALES_PER_K[axis] * (high - low) / 2.0) < 3.0 * doubt
        assert 0.0 < doubt < 0.006


def test_the_drift_adds_the_deviations_of_the_changed_parameters_and_of_the_tip() -> None:
    rng = np.random.default_rng(3)
    seen = warmed(FAMILY.draw(rng, 1)[0], rng)
    options = replace(PLAIN, drift=WARMING, state_regressors=seen.thermal_regressors[-1])
    found = identify(MODEL, seen, BAR, FAMILY, options)
    assert found.drift is not None
    basis = rng.normal(size=(2, 3, MODEL.size))
    for course in rng.normal(size=(4, seen.thermal_regressors.shape[1])):
        change = {name: value for name, (value, _) in found.drift.change(course).items()}
        tip = np.array([change.pop(f"tip {axis}") for axis in "XYZ"])
        expected = tip + sum(basis[:, :, MODEL.index(name)] * value for name, value in change.items())
        assert found.drift.deviations(basis, np.tile(course, (2, 1))) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_what_is_kept_of_an_estimate_knows_nothing_of_the_drift() -> None:
    rng = np.random.default_rng(2)
    seen = warmed(FAMILY.draw(rng, 1)[0], rng)
    options = replace(PLAIN, drift=WARMING, state_regressors=seen.thermal_regressors[-1])
    found = identify(MODEL, seen, BAR, FAMILY, options)
    assert found.unknowns.drift is None
    assert found.z.shape == (found.unknowns.blocks.size,)
    assert found.parameters == pytest.approx(found.unknowns.parameters(found.z))
    found.carried_over()
    early = identify(MODEL, seen, BAR, FAMILY, replace(PLAIN, drift=WARMING))
    place = MODEL.index("EXX[1]")
    moved = found.parameters[place] - early.parameters[place]
    assert found.drift is not None
    assert moved == pytest.approx(found.drift.change(seen.thermal_regressors[-1])["EXX[1]"][0])


def test_without_a_course_nothing_changes() -> None:
    rng = np.random.default_rng(3)
    truth = FAMILY.draw(rng, 1)[0]
    seen = measured("S3", 3, BAR, lambda at, tool: exact_deviation(MODEL, at, tool, truth), rng)
    plain = identify(MODEL, seen, BAR, FAMILY, Options())
    ready = identify(MODEL, seen, BAR, FAMILY, Options(drift=WARMING))
    assert (plain.parameters == ready.parameters).all()
    assert ready.drift is None


def test_stated_uncertainty_of_the_drifted_parameters_holds() -> None:
    """For machines and drifts drawn from their priors, errors are as large as stated."""
    squares = []
    for seed in range(60):
        rng = np.random.default_rng([7, seed])
        truth = FAMILY.prior_standard_deviation * rng.standard_normal(MODEL.size)
        still = measured("S3", 3, BAR, truth_of(MODEL, truth), rng)
        course = np.linspace(0.0, 2.0, still.size)[:, None]
        options = replace(PLAIN, drift=WARMING, state_regressors=course[-1])
        found = identify(MODEL, replace(still, thermal_regressors=course), BAR, FAMILY, options)
        assert found.drift is not None
        drift = found.drift.drift
        drawn = rng.standard_normal(drift.size)
        basis = deviation_basis(MODEL, still.axis_positions, TOOL)
        shift = drift.columns(basis, course) @ drawn
        moved = replace(still, axis_positions=still.axis_positions - shift, thermal_regressors=course)
        found = identify(MODEL, moved, BAR, FAMILY, options)
        late = truth.copy()
        late[list(drift.parameter_indices)] += drift.change(drawn, course[-1])[: len(drift.parameter_indices)]
        field = deviation_basis(MODEL, GRID, TOOL)
        error = field.reshape(-1, MODEL.size) @ (late - found.parameters)
        stated = np.einsum("nip,pq,niq->", field, found.covariance, field)
        squares.append(float(error @ error / stated))
    assert 0.7 < np.mean(squares) < 1.4


def test_the_expansion_of_the_bar_is_as_uncertain_as_its_coefficient() -> None:
    """±1e-6/K at 5 K from 20 °C is ±5 µm/m on every scale, and no set of positions can reduce it."""
    doubtful = bar(cte_standard_uncertainty_per_k=1e-6)
    sigma = {}
    for temperature_c in (20.0, 25.0):
        rng = np.random.default_rng(4)
        seen = measured("S3", 3, doubtful, lambda at, tool: np.zeros_like(at), rng, temperature_c=temperature_c)
        wide = FAMILY.prior_standard_deviation * 20.0
        found = identify(MODEL, seen, doubtful, FAMILY, replace(PLAIN, prior_standard_deviation=wide))
        sigma[temperature_c] = found.standard_uncertainty[MODEL.index("EXX[1]")]
    assert np.hypot(sigma[20.0], 5e-6 * 2000.0) == pytest.approx(sigma[25.0], rel=0.05)


def test_the_course_follows_the_thermometer_and_begins_at_zero() -> None:
    instants = np.arange(0.0, 3600.0, 12.0)
    exact = 20.0 + 3.0 * (1.0 - np.exp(-instants / 1200.0))
    told = exact + 0.02 * np.random.default_rng(5).standard_normal(len(instants))
    model, course = choose_model(MachineTemperatures(instants, told, 3.0), DriftPrior())
    assert isinstance(model, DriftByThermometer)
    assert (course[0] == 0.0).all()
    inside = slice(15, -15)
    assert np.abs(smooth_readings(instants, told) - exact)[inside].max() < 0.02
    assert np.std(course[inside, 0] - (exact[inside] - exact[0])) < 0.008


def test_without_a_thermometer_the_course_is_that_of_the_time() -> None:
    model, course = choose_model(MachineTemperatures(np.array([7.0, 1807.0, 3607.0]), None, 3.0), DriftPrior())
    assert isinstance(model, DriftByTime)
    assert course == pytest.approx(np.array([[0.0, 0.0], [1.5, 0.3], [3.0, 1.2]]))


def test_smoothing_keeps_straight_lines_and_lone_readings() -> None:
    instants = np.array([0.0, 10.0, 50.0, 1000.0, 1400.0, 1450.0])
    assert smooth_readings(instants, 20.0 + 0.01 * instants) == pytest.approx(20.0 + 0.01 * instants)


@pytest.mark.parametrize("name", ["strain_per_k", "bending_per_k", "tip_mm_per_k"])
def test_a_prior_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(DataError, match=name):
        DriftPrior(**{name: 0.0})
