"""Fields of the effects against touches and growth computed step by step, and the closed form against estimates."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured
from scipy.optimize import least_squares

from twin.artefact.observations import Observations
from twin.artefact.touch_pattern import approach_directions
from twin.errors import DataError
from twin.identification import identify
from twin.identification.options import Options
from twin.machine.machine_population import Family
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.error_budget import error_budget
from twin.uncertainty.measurement_effects import (
    BENDING,
    GROWTH,
    LOST_MOTION,
    LobingEffect,
    LostMotionEffect,
    MeasurementEffect,
    WarmingEffect,
)
from twin.uncertainty.monte_carlo import draw_truth, simulated_observations
from twin.uncertainty.truth_assumptions import TruthAssumptions

MODEL, FAMILY = case_study(3)
NOBODY = Family(MODEL, np.zeros(MODEL.size))
NOTHING = TruthAssumptions(NOBODY, touch_noise=False, certificate=False, cte=False)
DOWN = np.array([0.0, 0.0, -1.0])
PATTERNS = {count: approach_directions(count, DOWN) for count in (3, 5, 13)}
RADIUS_MM = 11.0


def planned(expression: str = "S1") -> Observations:
    rng = np.random.default_rng(0)
    seen = measured(expression, 3, bar(5, 15.0, 0.0), lambda at, _: np.zeros_like(at), rng, sigma_mm=0.0)
    return replace(seen, covariance=np.tile(1e-6 * np.eye(3), (seen.size, 1, 1)))


def fitted_centre(points: np.ndarray, free: bool) -> np.ndarray:
    """Centre of the sphere through displayed points; its radius is `RADIUS_MM` unless it is free."""

    def gaps(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - x[:3], axis=1) - (x[3] if free else RADIUS_MM)

    start = [0.0, 0.0, 0.0, RADIUS_MM][: 4 if free else 3]
    return np.asarray(least_squares(gaps, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x[:3])


@pytest.mark.parametrize("count", PATTERNS)
def test_lost_motion_shifts_a_centre_as_the_touches_of_lagging_slides_do(count: int) -> None:
    """Each axis reads too far in the direction in which it moves, by half of the lost motion at its place."""
    at, sigma_mm = planned(), 6e-3
    fields = LostMotionEffect(sigma_mm, [PATTERNS[count]]).fields(MODEL, at)
    sizes = np.random.default_rng(4).standard_normal(6)
    low, high = np.array(RANGES).T
    for row in (0, at.size // 2, at.size - 1):
        place = (at.axis_positions[row] - low) / (high - low)  # 0 to 1
        # of equal variance: a constant, and a line through the middle whose mean square over the travel is one
        lost = (
            sigma_mm
            / math.sqrt(2.0)
            * (sizes.reshape(3, 2) * np.array([[1.0, 12.0**0.5 * (p - 0.5)] for p in place])).sum(axis=1)
        )
        shown = [-RADIUS_MM * d + 0.5 * lost * np.sign(np.where(np.abs(d) < 1e-9, 0.0, d)) for d in PATTERNS[count]]
        expected = fitted_centre(np.array(shown), free=count > 3)
        assert fields[row] @ sizes == pytest.approx(expected, abs=2e-5)  # second order: 6 µm of 11 mm


@pytest.mark.parametrize("count", PATTERNS)
def test_lobes_shift_every_centre_alike_by_what_the_pattern_makes_of_them(count: int) -> None:
    """A probe that trips later by a cos 3(φ-ψ), φ counted around the stylus, is displayed as much deeper."""
    at, amplitude_mm, psi, touches = planned(), 3e-3, 0.7, PATTERNS[count]
    fields = LobingEffect(amplitude_mm, [touches]).fields(MODEL, at)
    assert np.ptp(fields, axis=0) == pytest.approx(np.zeros((3, 2)))
    deeper = [amplitude_mm * math.cos(3.0 * (math.atan2(y, x) - psi)) * math.hypot(x, y) for x, y, _ in touches]
    shown = np.array([-(RADIUS_MM - e) * d for e, d in zip(deeper, touches, strict=True)])
    shift = fitted_centre(shown, free=count > 3)
    # some direction of the lobes, of this amplitude, gives this shift: each of both sizes has a mean square of one
    sizes = np.linalg.lstsq(fields[0], shift, rcond=None)[0]
    assert fields[0] @ sizes == pytest.approx(shift, abs=2e-6)
    assert np.hypot(*sizes) == pytest.approx(math.sqrt(2.0), rel=2e-3)


def test_a_machine_that_warms_grows_by_twelve_micrometres_per_metre_and_kelvin_until_its_last_ball() -> None:
    at, rise_k = planned(), 2.5
    fields = WarmingEffect(rise_k, bends=False).fields(MODEL, at)
    share = np.arange(at.size) / (at.size - 1)
    middle = np.mean(RANGES, axis=1)
    wanted = np.zeros((at.size, 3, 6))
    for axis in range(3):
        wanted[:, axis, axis] = 12e-6 * rise_k * share * (at.axis_positions - middle)[:, axis]
        wanted[:, axis, 3 + axis] = 0.03 * rise_k * share
    # the same fields in any order and with any sign
    assert np.einsum("nik,mjk->nimj", fields, fields) == pytest.approx(
        np.einsum("nik,mjk->nimj", wanted, wanted), abs=1e-12
    )


def test_a_machine_that_bends_bows_its_guides_at_once_and_with_a_lag() -> None:
    at, rise_k = planned(), 1.5
    fields = WarmingEffect(rise_k, bends=True).fields(MODEL, at)
    share = np.arange(at.size) / (at.size - 1)
    low, high = RANGES[0]
    x = (2.0 * at.axis_positions[:, 0] - low - high) / (high - low)
    bow = np.zeros((at.size, 3))
    bow[:, 2] = 0.7e-6 * rise_k * 0.5 * (high - low) * (1.5 * x**2 - 0.5)  # straightness EZX, the second Legendre term
    for course in (share, 0.4 * share**2):
        wanted = course[:, None] * bow
        gaps = [min(np.abs(wanted - sign * one).max() for sign in (1, -1)) for one in np.moveaxis(fields, 2, 0)]
        assert min(gaps) < 1e-12


EFFECTS: dict[str, MeasurementEffect] = {
    LOST_MOTION: LostMotionEffect(5e-3, [PATTERNS[5]]),
    GROWTH: WarmingEffect(1.0, bends=False),
    BENDING: WarmingEffect(1.0, bends=True),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_the_closed_form_is_the_sum_over_estimates_of_each_field_alone(name: str) -> None:
    effect, artefact, at = EFFECTS[name], bar(5, 15.0, 0.0), planned()
    options = Options(estimate_scales=False, outliers="none")
    grid = evaluation_grid(RANGES, (5, 4, 4))
    assumptions = replace(NOTHING, effects=(effect,))
    budget = error_budget(MODEL, FAMILY, artefact, at, options, assumptions, grid, TOOL)
    assert list(budget.contributions)[-1] == name
    form, total = budget.field.form, 0.0
    for field in np.moveaxis(effect.fields(MODEL, at), 2, 0):
        moved = replace(at, axis_positions=at.axis_positions + field)
        total += form.value(identify(MODEL, moved, artefact, FAMILY, options).parameters).aligned_mm ** 2
    assert budget.expected.aligned_mm**2 == pytest.approx(total, rel=0.01)
    assert budget.expected.aligned_mm > 1e-4


def test_a_simulated_measurement_has_the_effect_and_all_else_as_before() -> None:
    at, artefact = planned(), bar(5, 15.0, 0.5e-3)
    truth = TruthAssumptions(FAMILY)
    machine = draw_truth(truth, np.random.default_rng(3), TOOL)
    with_it = replace(truth, effects=(EFFECTS[LOST_MOTION],))
    before, after = (
        simulated_observations(at, artefact, machine, one, np.random.default_rng(7)).axis_positions
        for one in (truth, with_it)
    )
    moved = (after - before).ravel()
    fields = EFFECTS[LOST_MOTION].fields(MODEL, at).reshape(moved.size, -1)
    left = moved - fields @ np.linalg.lstsq(fields, moved, rcond=None)[0]
    assert np.abs(moved).max() > 1e-4
    assert np.abs(left).max() < 1e-9


@pytest.mark.parametrize("size", [-1.0, math.nan, math.inf])
def test_a_size_that_none_can_have_is_refused(size: float) -> None:
    for make in (
        lambda: LostMotionEffect(size, [PATTERNS[5]]),
        lambda: WarmingEffect(size, bends=True),
        lambda: LobingEffect(size, [PATTERNS[5]]),
    ):
        with pytest.raises(DataError, match="finite and not negative"):
            make()


def test_one_effect_is_not_stated_twice() -> None:
    effect = WarmingEffect(1.0, bends=True)
    with pytest.raises(DataError, match="an effect occurs twice"):
        replace(NOTHING, effects=(effect, effect))
