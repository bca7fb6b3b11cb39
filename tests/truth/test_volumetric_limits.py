"""The limits that every identification states, against the exact distributions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from campaigns.foreign.artefact import NOISE_MM, S1, S3, STATIONS_MM, measure, tilted_bar
from campaigns.foreign.machine import GRID, RANGES, TOOL, foreign_machine
from campaigns.foreign.score import family_of, score, true_error_um
from twin.identification import identify, predicted_vce
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.quadratic_distribution import QuadraticDistribution
from twin.uncertainty.volumetric_distribution import aligned_distributions
from twin.uncertainty.volumetric_limits import mixture_quantiles, volumetric_limits

PROBABILITIES = (0.025, 0.25, 0.5, 0.975)


@pytest.mark.parametrize("freedom", [2, 5, 90])
@pytest.mark.parametrize("noncentral", [0.0, 2.5, 400.0])
def test_quantiles_of_chi_square(freedom: int, noncentral: float) -> None:
    shifts = np.zeros(freedom)
    shifts[0] = np.sqrt(noncentral)
    found = np.sqrt(mixture_quantiles([QuadraticDistribution(np.ones(freedom), shifts, 0.0)], PROBABILITIES))
    tolerance = 0.02 if freedom == 2 else 0.005
    assert found == pytest.approx(np.sqrt(stats.ncx2.ppf(PROBABILITIES, freedom, noncentral)), rel=tolerance)


def test_a_mixture_of_very_different_parts() -> None:
    parts = [QuadraticDistribution(np.full(20, weight), np.zeros(20), 0.0) for weight in (1e-6, 1.0, 2.0)]
    at = mixture_quantiles(parts, PROBABILITIES)
    known = np.mean([stats.chi2.cdf(at / part.weights[0], 20) for part in parts], axis=0)
    assert known == pytest.approx(PROBABILITIES, abs=2e-3)


def test_a_field_that_is_known_exactly_has_no_spread() -> None:
    parts = [QuadraticDistribution(np.zeros(0), np.zeros(0), 4.0)]
    assert mixture_quantiles(parts, (0.025, 0.975)) == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize(
    ("orientations", "stations", "worse"),
    [(S3, STATIONS_MM, 1.0), (S3, STATIONS_MM, 0.1), (S1, STATIONS_MM, 10.0), (S3[:2], STATIONS_MM[1:2], 0.1)],
)
def test_limits_of_an_estimate(
    orientations: Sequence[tuple[float, float]], stations: Sequence[Sequence[float]], worse: float
) -> None:
    rng = np.random.default_rng(3)
    machine, bar = foreign_machine(rng, worse), tilted_bar(rng)
    seen = measure(machine, bar, orientations, np.random.default_rng(103), stations=stations).seen
    estimate, grid = score(machine, bar, seen).estimate, evaluation_grid(RANGES)
    found, exact = volumetric_limits(estimate, grid, TOOL), aligned_distributions(estimate, grid, TOOL)
    ve, vce = (exact.ve, exact.resolved_ve, found.ve_um), (exact.vce, exact.resolved_vce, found.vce_um)
    for above, below, limits_um in (ve, vce):
        exact_mm2 = (below.quantile(0.025), above.quantile(0.975))
        assert limits_um == pytest.approx(1e3 * np.sqrt(exact_mm2), rel=0.01)


def test_touches_that_scatter_more_than_stated_may_leave_a_better_machine() -> None:
    """The centres cannot tell such touches from errors of the machine between the balls. The lower limit must hold
    although the expected error counts all of it as error of the machine."""
    family = family_of(8)
    for number in range(4):
        rng = np.random.default_rng([number, 8])
        machine, bar = foreign_machine(rng, 0.5), tilted_bar(rng)
        seen = measure(machine, bar, S3, rng).seen
        scattered = seen.axis_positions + rng.normal(0.0, np.sqrt(3.0) * NOISE_MM, seen.axis_positions.shape)
        estimate = identify(family.model, replace(seen, axis_positions=scattered), bar.artefact, family)
        lower, upper = volumetric_limits(estimate, GRID, TOOL).vce_um
        assert lower < true_error_um(machine, estimate) < upper
        assert true_error_um(machine, estimate) < 0.9 * predicted_vce(estimate, GRID, TOOL).aligned_um
