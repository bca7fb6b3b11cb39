"""Held-out positions of a straight bar: deviations of the machine that turn the fitted bar about its line neither hide
nor invent anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from campaigns.foreign.artefact import NOISE_MM, straight_bar, turned_bar
from twin.artefact.artefact import Artefact
from twin.artefact.held_out_check import HeldOutResiduals, HeldOutTest, held_out_covariance, held_out_residuals
from twin.artefact.observations import Observations

BALLS = 11
ALONG = np.linspace(-1.0, 1.0, BALLS)
SHAPES = np.stack((ALONG**2, ALONG**3, np.cos(4.0 * ALONG), np.sin(5.0 * ALONG)), axis=1)
EXPECTED_SPREAD = np.sqrt(2.0 / 26.0)  # standard deviation of χ² per degree of freedom


def observed(points: np.ndarray, elevation_deg: float) -> Observations:
    return Observations(
        position=np.zeros(BALLS, dtype=int),
        ball=np.arange(BALLS),
        tool=np.zeros(BALLS, dtype=int),
        axis_positions=points,
        covariance=np.tile(np.eye(3) * NOISE_MM**2, (BALLS, 1, 1)),
        temperature_c=np.full(BALLS, 20.0),
        elevation_rad=np.full(BALLS, np.radians(elevation_deg)),
        azimuth_rad=np.full(BALLS, np.radians(45.0)),
        tool_offsets=np.zeros((1, 3)),
    )


def proof(
    seed: int, off_axis_mm: float, field_mm: float, sag_mm: float = 0.0
) -> tuple[Artefact, np.ndarray, HeldOutResiduals, HeldOutTest]:
    """Return the artefact, the measured points, the residuals and their test, for a random smooth field and roll."""
    rng = np.random.default_rng(seed)
    bar = straight_bar(rng, off_axis_mm)
    artefact = replace(bar.artefact, sag_mm=sag_mm)
    shapes = 0.5 * field_mm * SHAPES
    field = shapes @ rng.normal(size=(SHAPES.shape[1], 3))
    rotation = turned_bar(np.radians(45.0), np.radians(30.0), rng.uniform(-np.pi, np.pi))
    downwards = rotation[:, 0] * rotation[2, 0] - [0.0, 0.0, 1.0]
    points = bar.true @ rotation.T + artefact.droop_mm[:, None] * downwards
    points += field + rng.normal(0.0, NOISE_MM, points.shape)
    seen = observed(points, 30.0)
    result = held_out_residuals(seen, points, artefact)
    covariance = np.asarray(np.kron(shapes @ shapes.T, np.eye(3)), dtype=np.float64)
    return (
        artefact,
        points,
        result,
        held_out_covariance(seen, result.placed_mm, artefact, covariance).test(result.residuals_mm),
    )


@pytest.mark.parametrize("sag_mm", [0.0, 0.010])
@pytest.mark.parametrize("field_mm", [0.002, 0.015])
@pytest.mark.parametrize("off_axis_mm", [0.0, 0.0005, 0.002, 0.005])
def test_the_test_has_its_stated_distribution(off_axis_mm: float, field_mm: float, sag_mm: float) -> None:
    tests = [proof(seed, off_axis_mm, field_mm, sag_mm) for seed in range(100)]
    chi2 = np.array([test.chi2_normalised for _, _, _, test in tests])
    assert chi2.mean() == pytest.approx(1.0, abs=0.1)
    assert chi2.std() < 1.25 * EXPECTED_SPREAD
    residual = np.mean([result.rms_mm**2 for _, _, result, _ in tests])
    predicted = np.mean([test.predicted_mm**2 for _, _, _, test in tests])
    assert np.sqrt(residual / predicted) == pytest.approx(1.0, abs=0.08)


def test_a_bend_is_not_hidden_by_the_roll() -> None:
    """A bend of 10 µm that nothing predicts, in any direction across the bar, is found in every set."""
    rng, nothing = np.random.default_rng(1), np.zeros((3 * BALLS, 3 * BALLS))
    for seed in range(20):
        artefact, points, plain, _ = proof(seed, 0.005, 0.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        rotation = turned_bar(np.radians(45.0), np.radians(30.0), 0.0)
        across = rotation @ np.array([0.0, np.cos(angle), np.sin(angle)])
        bent = points + 0.010 * np.outer(ALONG**2, across)
        seen = observed(bent, 30.0)
        result = held_out_residuals(seen, bent, artefact)
        test = held_out_covariance(seen, result.placed_mm, artefact, nothing).test(result.residuals_mm)
        assert test.chi2_normalised > 2.1  # exceeded by noise with a probability of 1e-3
        assert result.rms_mm > 1.3 * plain.rms_mm
