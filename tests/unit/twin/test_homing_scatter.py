"""Scatter of a homing, and its effect on a corrected machine, against many simulated homings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin.arrays import Array
from twin.artefact.homing_count import FEWEST_HOMINGS
from twin.artefact.homing_scatter import homing_scatter
from twin.errors import DataError
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.homing_effect import homing_effect
from twin.machine.kinematic_chain import parse_chain
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms

TOUCHES = np.array([1.0, 0.5, 2.0])
OFFSET = np.array([0.0, 0.0, -150.0])


def test_limits_are_those_of_chi_square_without_the_variance_of_the_touches() -> None:
    centres = np.array([[0.0, 1.0, 7.0], [4.0, 1.5, 7.1], [8.0, 0.5, 6.9], [5.0, 1.2, 7.0]])
    x, y, z = homing_scatter(centres, TOUCHES)
    s2 = float(np.var(centres[:, 0], ddof=1))
    assert x.sigma == pytest.approx(np.sqrt(s2 - 1.0))
    assert x.lower == pytest.approx(np.sqrt(s2 * 3 / chi2.ppf(0.975, 3) - 1.0))
    assert x.upper == pytest.approx(np.sqrt(s2 * 3 / chi2.ppf(0.025, 3) - 1.0))
    assert (y.sigma, y.lower) == (0.0, 0.0)
    assert y.upper == pytest.approx(np.sqrt(np.var(centres[:, 1], ddof=1) * 3 / chi2.ppf(0.025, 3) - 0.25))
    assert (z.sigma, z.lower, z.upper, z.touches) == (0.0, 0.0, 0.0, 2.0)


@pytest.mark.parametrize("homings", [3, 5, 12])
@pytest.mark.parametrize("sigma", [0.0, 2.0, 10.0])
def test_the_limits_hold_the_truth_as_often_as_they_say(homings: int, sigma: float) -> None:
    rng = np.random.default_rng(homings)
    held = []
    for _ in range(2000):
        centres = rng.normal(0.0, np.hypot(sigma, TOUCHES), (homings, 3))
        held += [one.lower <= sigma <= one.upper for one in homing_scatter(centres, TOUCHES)]
    # without any scatter, only an upper limit can be wrong, and it is at least 0
    assert np.mean(held) == pytest.approx(0.95 if sigma else 0.975, abs=0.01)


def test_two_homings_show_no_scatter() -> None:
    with pytest.raises(DataError, match="2 homings do not show a scatter"):
        homing_scatter(np.zeros((FEWEST_HOMINGS - 1, 3)), TOUCHES)


def machine() -> tuple[ErrorModel, Array]:
    """Return a bad machine: 50 µm straightness and positioning errors, and rotations of 100 µrad."""
    chain = parse_chain("tool-Z-X-bed-Y-workpiece")
    model = ErrorModel.uniform(chain, ((0.0, 800.0), (0.0, 500.0), (0.0, 300.0)), order=4)
    rng = np.random.default_rng(3)
    unit = np.array([1e-4 if parameter.unit == "rad" else 0.05 for parameter in model.parameters])
    return model, rng.normal(0.0, 1.0, model.size) * unit


def test_effect_is_that_of_many_homings_on_a_corrected_machine() -> None:
    model, errors = machine()
    grid = evaluation_grid(model.ranges_mm, (9, 7, 5))
    sigma_mm = np.array([0.02, 0.05, 0.01])
    points = grid + OFFSET

    def tips(displayed: Array, zero: Array) -> Array:
        """Where the tip is if a perfect table corrects the displayed position, without the shift of the zero itself."""
        correction = -exact_deviation(model, displayed, OFFSET, errors)
        return correction + exact_deviation(model, displayed + zero, OFFSET, errors)

    rng = np.random.default_rng(4)
    raw, aligned = [], []
    for zero in rng.normal(0.0, sigma_mm, (1500, 3)):
        field = tips(grid, zero)
        raw.append(rms(field) ** 2)
        aligned.append(rms(align_rigidly(points, field)) ** 2)
    effect = homing_effect(model, errors[:, None], OFFSET, sigma_mm, grid)
    assert effect.raw_mm == pytest.approx(np.sqrt(np.mean(raw)), rel=0.05)
    assert effect.aligned_mm == pytest.approx(np.sqrt(np.mean(aligned)), rel=0.05)
    assert effect.aligned_mm < effect.raw_mm


def test_effect_of_one_axis_is_the_difference_of_its_errors() -> None:
    model, errors = machine()
    grid = evaluation_grid(model.ranges_mm, (6, 5, 4))
    for axis in range(3):
        sigma_mm = np.zeros(3)
        sigma_mm[axis] = 1e-3
        there, here = (exact_deviation(model, grid + sign * sigma_mm, OFFSET, errors) for sign in (1.0, -1.0))
        effect = homing_effect(model, errors[:, None], OFFSET, sigma_mm, grid)
        assert effect.raw_mm == pytest.approx(rms(there - here) / 2.0, rel=0.01)


def test_effect_on_an_unknown_machine_is_that_of_many_machines() -> None:
    model, errors = machine()
    grid = evaluation_grid(model.ranges_mm, (5, 4, 3))
    spread = np.abs(errors)
    sigma_mm = np.array([0.02, 0.05, 0.01])
    rng = np.random.default_rng(5)
    drawn = [
        homing_effect(model, (rng.normal(0.0, 1.0, model.size) * spread)[:, None], OFFSET, sigma_mm, grid).aligned_mm
        for _ in range(300)
    ]
    expected = homing_effect(model, np.diag(spread), OFFSET, sigma_mm, grid)
    assert expected.aligned_mm == pytest.approx(np.sqrt(np.mean(np.square(drawn))), rel=0.1)
