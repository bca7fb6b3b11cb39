"""Drift of the machine between nights: its size by closed forms, its likelihood by dense algebra, and its false
alarms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured

from twin.artefact.observations import Observations
from twin.identification import DriftFactor, Estimate, Options, Scales, identify, process_noise
from twin.machine.forward_model import exact_deviation
from twin.monitoring.night_fit import NightFit, compare_with_nights_before
from twin.monitoring.step_detection import innovation

MODEL, FAMILY = case_study(3)
SIGMA = FAMILY.prior_standard_deviation
BAR = bar(7, sigma_mm=0.8e-3)
TRUTH = FAMILY.draw(np.random.default_rng(5), 1)[0]
FIXED = Options(estimate_scales=False, outliers="none", misfit_mm=0.0005)
WALK = 0.05 * SIGMA


def night(expression: str, seed: int, change: np.ndarray | None = None) -> Observations:
    truth = TRUTH if change is None else TRUTH + change

    def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(MODEL, at, tool, truth)

    return measured(expression, 2, BAR, deviation, np.random.default_rng(seed), sigma_mm=1e-3)


@pytest.fixture(scope="module")
def first() -> Estimate:
    return identify(MODEL, night("S1+S2+S3", 1), BAR, FAMILY, FIXED)


def compared(first: Estimate, seen: Observations, walk: np.ndarray = WALK) -> NightFit:
    return compare_with_nights_before(FAMILY, seen, BAR, first.carried_over(), walk)


def test_the_misfit_walks_in_the_same_proportion_as_the_machine(first: Estimate) -> None:
    scales = Scales(1.0, 1.0, 3.0, 0.5, 1.0, 4.0, *(2.4 for _ in "xyz"), *(1.6 for _ in "xyz"))  # motions: rms 2
    known = replace(first.carried_over(), scales=scales, drift_factor=DriftFactor(1.5, 0.1))
    later = known.after(WALK, nights=4.0)
    added, blocks = np.diag(later.covariance - known.covariance), known.unknowns.blocks
    assert added[blocks.parameters] == pytest.approx(4.0 * (1.5 * 0.05) ** 2, rel=1e-9)
    for kind, scale in zip(blocks.kinds, scales.kinds, strict=True):
        assert added[kind] == pytest.approx(4.0 * (1.5 * 0.05 / 2.0 * scale) ** 2, rel=1e-9)
    assert not added[blocks.certificate].any()
    assert not added[blocks.strain].any()


def test_without_process_noise_nothing_walks_and_nothing_is_learned(first: Estimate) -> None:
    found = compared(first, night("S3", 2), 0.0 * SIGMA)
    assert found.fits
    assert (found.prior.covariance == first.carried_over().covariance).all()
    assert found.prior.drift_factor == DriftFactor()


def test_the_likelihood_of_the_drift_is_that_of_dense_algebra(first: Estimate) -> None:
    """The posterior of ln f by quadrature of densities that are computed anew for each factor f."""
    seen, known = night("S3", 3, WALK * np.random.default_rng(3).normal(size=MODEL.size)), first.carried_over()
    logs = np.linspace(math.log(0.05), math.log(12.0), 60)
    density = []
    for log in logs:
        walked = replace(known, drift_factor=DriftFactor(math.exp(log))).after(WALK)
        found = innovation(FAMILY, seen, BAR, walked)
        # ln det(1 + f² W F₀) from the information with and without the walk: det(1 + V F₀) = det(F₀) / det(F)
        still = innovation(FAMILY, seen, BAR, known)
        added = walked.covariance - known.covariance
        determinant = np.linalg.slogdet(np.eye(len(added)) + added @ still.information)[1]
        density.append(-0.5 * (found.chi2 + determinant) - 0.5 * (log / math.hypot(math.log(3.0), 0.2)) ** 2)
    weights = np.exp(np.array(density) - max(density))
    mean = float(weights @ logs / weights.sum())
    deviation = math.sqrt(float(weights @ (logs - mean) ** 2 / weights.sum()))
    learned = compared(first, seen).prior.drift_factor
    assert learned.value == pytest.approx(math.exp(mean), rel=0.02)
    assert learned.log_deviation == pytest.approx(deviation, rel=0.05)


def test_another_bar_with_fewer_unknowns_says_the_same_about_the_drift(first: Estimate) -> None:
    seen = night("S3", 5, 2.0 * WALK)
    sure = bar(7, sigma_mm=0.8e-3, cte_standard_uncertainty_per_k=1e-9)
    perfect = replace(sure, covariance=np.zeros_like(sure.covariance))
    known, bars = first.carried_over(), (BAR, sure, perfect)
    found = [compare_with_nights_before(FAMILY, seen, artefact, known, WALK) for artefact in bars]
    assert found[1].factor == pytest.approx(found[0].factor, rel=0.3)
    assert found[2].factor == pytest.approx(found[0].factor, rel=0.3)


@pytest.mark.parametrize("times", [2.0, 5.0])
def test_the_drift_is_learned_from_several_nights(first: Estimate, times: float) -> None:
    rng, estimate, change = np.random.default_rng(17), first, np.zeros(MODEL.size)
    for number in range(8):
        change = change + times * WALK * rng.normal(size=MODEL.size)
        seen = night("S3", 20 + number, change)
        found = compared(estimate, seen)
        estimate = identify(MODEL, seen, BAR, FAMILY, replace(FIXED, carried_over=found.prior))
    assert estimate.drift_factor == found.prior.drift_factor
    factor = estimate.drift_factor
    assert factor.log_deviation < 0.4  # of 1.1 at the start
    assert abs(math.log(factor.value / times)) < 3.0 * factor.log_deviation


def test_a_jump_does_not_fit_and_is_named(first: Estimate) -> None:
    change = np.zeros(MODEL.size)
    change[MODEL.index("EYX[2]")] = 12e-3
    found = compared(first, night("S3", 4, change))
    assert not found.fits
    assert found.probability < 1e-6
    assert found.suspect is not None
    assert found.suspect.error == "EYX"
    assert found.factor > 2.0  # the night is fused with room for the change


def test_false_alarms_are_rare_if_the_machine_walks_as_stated(first: Estimate) -> None:
    rng, alarms, nights = np.random.default_rng(9), 0, 100
    for number in range(nights):
        truth = first.carried_over()
        drawn = rng.multivariate_normal(truth.mean, truth.covariance)
        change = SIGMA * drawn[: MODEL.size] - TRUTH + WALK * rng.normal(size=MODEL.size)
        seen = night("S3", 100 + number, change)
        found = compare_with_nights_before(FAMILY, seen, BAR, truth, WALK, night_false_alarm=0.05)
        alarms += not found.fits
    assert alarms <= 12  # 5 % on average; the machine is drawn from what is known about it


def test_process_noise_of_the_field_moves_the_misfit(first: Estimate) -> None:
    known = first.carried_over()
    added = known.walk_variances(process_noise(FAMILY, 1e-3, TOOL))
    assert (added[known.unknowns.blocks.misfit] > 0.0).all()
