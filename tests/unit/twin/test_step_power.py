"""Power of a verification in closed form, compared with drawn scores, and the choice of positions by it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from measured_set import bar, case_study, measured

from twin.artefact.observations import Observations
from twin.identification import Options, identify
from twin.identification.jump import ERRORS, coefficients_of, jump_evidence
from twin.machine.error_model import SQUARENESS
from twin.machine.forward_model import exact_deviation
from twin.monitoring.step_detection import innovation
from twin.monitoring.step_power import (
    FALSE_ALARM,
    POWER,
    ROTATIONS,
    SmallestStep,
    StepPower,
    largest_of,
    rank_by_power,
    smoothest_step,
)

MODEL, FAMILY = case_study(3)
BAR = bar(7, sigma_mm=0.8e-3)
TRUTH = FAMILY.draw(np.random.default_rng(5), 1)[0]
DRAWS = 20_000


def seen(expression: str, seed: int) -> Observations:
    def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(MODEL, at, tool, TRUTH)

    return measured(expression, 2, BAR, deviation, np.random.default_rng(seed))


@cache
def power() -> StepPower:
    options = Options(outliers="none", misfit_mm=0.0002, estimate_scales=False)
    known = identify(MODEL, seen("S1+S2+S3", 1), BAR, FAMILY, options).carried_over()
    found = innovation(FAMILY, seen("S3", 2), BAR, known)
    return StepPower(found.unknowns, found.information)


def evidences(step: np.ndarray, seed: int) -> dict[str, np.ndarray]:
    """Return the evidence of each error in drawn verifications after a step (P,) of all unknowns."""
    one = power()
    values, vectors = np.linalg.eigh(one.information)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scores = one.information @ step + np.random.default_rng(seed).normal(size=(DRAWS, len(step))) @ root.T
    columns = {error: coefficients_of(one.unknowns, error) for error in ERRORS}
    return {
        error: jump_evidence(scores[:, at], np.broadcast_to(one.information[np.ix_(at, at)], (DRAWS, *[len(at)] * 2)))[
            0
        ]
        for error, at in columns.items()
        if at.size
    }


def step_of(error: str, size: float) -> np.ndarray:
    step = np.zeros(power().unknowns.blocks.size)
    step[coefficients_of(power().unknowns, error)] = size * smoothest_step(power().unknowns, error)
    return step


@pytest.mark.parametrize("error", ["C0Y", "B0Z", "EAX", "ECZ", "EXX", "EYX"])
def test_the_smallest_step_is_found_with_its_probability(error: str) -> None:
    limit = power().evidence_for()
    smallest = power().smallest(error, limit)
    assert smallest.size is not None
    found = float(np.mean(evidences(step_of(error, smallest.size), 3)[error] >= limit))
    assert found == pytest.approx(POWER, abs=4.0 * np.sqrt(POWER * (1.0 - POWER) / DRAWS))
    half = float(np.mean(evidences(step_of(error, 0.5 * smallest.size), 4)[error] >= limit))
    expected = power().power(error, 0.5 * smallest.size, limit)
    assert half == pytest.approx(expected, abs=4.0 * np.sqrt(0.25 / DRAWS))
    assert half < POWER - 0.1


@pytest.mark.parametrize("false_alarm", [1e-4, FALSE_ALARM, 0.2])
def test_what_finds_a_step_is_decided_as_with_the_limit_of_the_evidence(false_alarm: float) -> None:
    limit = power().evidence_for(false_alarm)
    sizes = [power().smallest(error, limit).size for error in SQUARENESS]
    largest = max(size for size in sizes if size is not None)
    assert power().finds(SQUARENESS, 1.0001 * largest, false_alarm)
    assert not power().finds(SQUARENESS, 0.9999 * largest, false_alarm)
    assert not power().finds(SQUARENESS, 1e-3, false_alarm), "a step that an evidence of 0 does not find either"
    assert power().finds(SQUARENESS, 1e4, false_alarm), "a step that the largest evidence finds"


def test_false_alarms_stay_below_their_bound() -> None:
    limit = power().evidence_for()
    assert power().false_alarm(limit) == pytest.approx(FALSE_ALARM, rel=1e-6)
    largest = np.max(list(evidences(step_of("C0Y", 0.0), 5).values()), axis=0)
    alarms = float(np.mean(largest >= limit))
    noise = 4.0 * np.sqrt(FALSE_ALARM / DRAWS)
    assert alarms <= FALSE_ALARM + noise
    # several errors look alike, so the sum counts some alarms more than once
    assert alarms >= 0.3 * FALSE_ALARM


def test_a_larger_limit_has_fewer_alarms_and_finds_larger_steps_only() -> None:
    assert power().false_alarm(8.0) < power().false_alarm(4.0) < power().false_alarm(0.0)
    low, high = (power().smallest("C0Y", limit).size for limit in (4.0, 8.0))
    assert low is not None
    assert high is not None
    assert low < high


def test_the_information_is_that_of_the_innovation() -> None:
    """Written out with the factor of the information instead of the normal equations."""
    rng = np.random.default_rng(1)
    one = power()
    size = one.unknowns.blocks.size
    factors = rng.normal(size=(3, 5, size))
    root = 0.1 * rng.normal(size=(size, size))
    covariance = root @ root.T + 1e-3 * np.eye(size)
    rows = factors.reshape(-1, size)
    before = np.linalg.inv(covariance)
    expected = before - before @ np.linalg.inv(before + rows.T @ rows) @ before
    found = StepPower.of(one.unknowns, factors, covariance).information
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_positions_are_ranked_by_what_they_add_per_minute() -> None:
    """A position that repeats another adds less than one that shows something else."""
    unknowns = power().unknowns
    covariance = 1e-3 * np.eye(unknowns.blocks.size)
    at = {error: int(coefficients_of(unknowns, error)[0]) for error in SQUARENESS}
    factors = np.zeros((4, 1, unknowns.blocks.size))
    for row, (error, strength) in zip(factors, [("A0Z", 4.0), ("A0Z", 3.9), ("B0Z", 3.0), ("C0Y", 0.0)], strict=True):
        row[0, at[error]] = strength / (10.0 * smoothest_step(unknowns, error)[0])
    steps = dict.fromkeys(SQUARENESS, 10.0)
    assert rank_by_power(unknowns, factors, covariance, steps, np.ones(4)) == [0, 1, 2]
    assert rank_by_power(unknowns, factors, covariance, steps, np.array([1.0, 9.0, 1.0, 1.0])) == [0, 2, 1]


def test_a_step_that_needs_more_than_others_gets_more_positions() -> None:
    """The ranking goes on when every step has the noncentrality that most steps need."""
    unknowns = power().unknowns
    covariance = 1e-6 * np.eye(unknowns.blocks.size)
    factors = np.zeros((3, 1, unknowns.blocks.size))
    factors[:, 0, int(coefficients_of(unknowns, "A0Z")[0])] = 8.0 / (10.0 * smoothest_step(unknowns, "A0Z")[0])
    assert sorted(rank_by_power(unknowns, factors, covariance, {"A0Z": 10.0}, np.ones(3))) == [0, 1, 2]


def test_an_error_that_nothing_shows_is_not_found() -> None:
    unknowns = power().unknowns
    blind = StepPower(unknowns, np.zeros((unknowns.blocks.size,) * 2))
    assert blind.smallest("C0Y", 4.0) == SmallestStep("C0Y", None, "µrad")
    assert largest_of([SmallestStep("A0Z", 5.0, "µrad"), SmallestStep("C0Y", None, "µrad")]).error == "C0Y"


def test_rotations_are_nine() -> None:
    assert len(ROTATIONS) == 9
    assert set(ROTATIONS) <= set(ERRORS)
