"""Predicted error with its covariance, aligned and unaligned, compared with the truth of foreign machines."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import volcal
from campaigns.foreign.artefact import S3, measure, tilted_bar
from campaigns.foreign.machine import RANGES, TOOL, ForeignMachine, foreign_machine
from campaigns.foreign.score import family_of
from twin.identification import Estimate, Options, identify_by_evidence
from twin.machine.volumetric import evaluation_grid, rigid_part

SEEDS = range(16)
LIMITS = 1.96  # standard uncertainties of a 95 % interval
TRANSLATION_MM, ROTATION_RAD = 8e-3, 6e-6  # rms of the rigid motions that these machines contain


@cache
def measured(seed: int) -> tuple[ForeignMachine, Estimate, np.ndarray]:
    """Return a machine, its estimate and random axis positions (100, 3)."""
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    seen = measure(machine, bar, S3, np.random.default_rng(seed + 100)).seen
    low, high = np.array(machine.ranges).T
    points = np.random.default_rng(seed + 500).uniform(low, high, (100, 3))
    return machine, identify_by_evidence(family_of, seen, bar.artefact, Options()), points


def aligned_truth(machine: ForeignMachine, points: np.ndarray) -> np.ndarray:
    grid = evaluation_grid(RANGES)
    return machine.deviation(points) - rigid_part(grid + TOOL, machine.deviation(grid), points + TOOL)


def share_inside(error: np.ndarray, prediction: volcal.Prediction) -> float:
    inside = np.abs(error - prediction.error_mm) < LIMITS * prediction.standard_uncertainty_mm
    return float(inside.mean())


def test_limits_of_the_aligned_error_contain_the_truth() -> None:
    shares = []
    for seed in SEEDS:
        machine, estimate, points = measured(seed)
        prediction = volcal.predict(estimate, points)
        assert prediction.aligned
        shares.append(share_inside(aligned_truth(machine, points), prediction))
    assert 0.93 < np.mean(shares) < 0.98


def test_limits_of_the_unaligned_error_contain_the_truth_if_the_rigid_motion_is_stated() -> None:
    shares = []
    for seed in SEEDS:
        machine, estimate, points = measured(seed)
        stated = volcal.RigidMotionUncertainty(TRANSLATION_MM, ROTATION_RAD)
        prediction = volcal.predict_unaligned(estimate, points, stated)
        assert not prediction.aligned
        shares.append(share_inside(machine.deviation(points), prediction))
    assert 0.93 < np.mean(shares) < 0.99


def test_without_an_uncertainty_of_the_rigid_motion_the_unaligned_limits_miss_the_truth() -> None:
    shares = []
    for seed in SEEDS:
        machine, estimate, points = measured(seed)
        prediction = volcal.predict_unaligned(estimate, points, volcal.RigidMotionUncertainty(0.0, 0.0))
        shares.append(share_inside(machine.deviation(points), prediction))
    assert np.mean(shares) < 0.6


def test_the_stated_rigid_motion_does_not_change_the_aligned_covariance() -> None:
    """The covariance that the unaligned prediction adds is that of rigid motions only."""
    _, estimate, points = measured(0)
    small, large = (
        volcal.predict_unaligned(estimate, points, volcal.RigidMotionUncertainty(*stated)).covariance_mm2
        for stated in ((0.0, 0.0), (1.0, 1e-3))
    )
    tool_points = points + TOOL
    fields = np.zeros((len(points), 3, 6))
    fields[:, :, :3] = np.eye(3)
    for axis in range(3):
        fields[:, :, 3 + axis] = 1e-3 * np.cross(np.eye(3)[axis], tool_points - tool_points.mean(axis=0))
    basis = np.linalg.qr(fields.reshape(-1, 6))[0]
    removed = np.eye(len(basis)) - basis @ basis.T
    np.testing.assert_allclose(removed @ (large - small) @ removed, 0.0, atol=1e-9)
    added = np.diagonal(large - small).reshape(-1, 3)
    middle = np.mean(evaluation_grid(estimate.model.ranges_mm), axis=0)
    arms = np.square(points - middle)
    np.testing.assert_allclose(added, 1.0 + 1e-6 * (arms.sum(axis=1)[:, None] - arms), rtol=1e-9)


@pytest.mark.parametrize("stated", [(-1.0, 0.0), (0.0, -1e-6), (float("nan"), 0.0)])
def test_a_negative_uncertainty_is_refused(stated: tuple[float, float]) -> None:
    with pytest.raises(volcal.DataError, match="standard uncertainty"):
        volcal.RigidMotionUncertainty(*stated)
