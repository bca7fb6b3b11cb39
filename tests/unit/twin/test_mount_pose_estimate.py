"""Estimate of a mount's pose, compared with motions constructed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.artefact.mount_pose_estimate import MountPoseEstimate

LINE = np.column_stack([np.linspace(-700.0, 700.0, 5), np.zeros(5), np.zeros(5)])
CROSS = np.column_stack([np.zeros(5), np.zeros(5), np.linspace(-700.0, 700.0, 5)])
SHIFT = np.array([0.3, -0.2, 0.1])
TILT = 5e-4


def turned_about_y(points: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return points rotated by TILT about Y, then shifted by SHIFT, by plain trigonometry."""
    out = points.copy()
    x, z = points[:, 0] - middle[0], points[:, 2] - middle[2]
    out[:, 0] = middle[0] + math.cos(TILT) * x + math.sin(TILT) * z
    out[:, 2] = middle[2] - math.sin(TILT) * x + math.cos(TILT) * z
    return out + SHIFT


def test_before_anything_was_found_nothing_is_moved() -> None:
    assert MountPoseEstimate.nominal().transform(LINE) is LINE


def test_a_tilted_mount_is_met_in_an_orientation_not_yet_measured() -> None:
    middle = np.array([10.0, 20.0, 30.0])
    standing = MountPoseEstimate.nominal().with_found_balls(LINE, turned_about_y(LINE, middle))
    assert standing.transform(CROSS) == pytest.approx(turned_about_y(CROSS, middle), abs=1e-3)


def test_a_turn_about_the_bars_own_axis_is_not_made_up() -> None:
    noise = np.random.default_rng(3).normal(0.0, 1e-3, LINE.shape)
    carried = MountPoseEstimate.nominal().with_found_balls(LINE, LINE + SHIFT + noise).transform(CROSS)
    assert carried == pytest.approx(CROSS + SHIFT, abs=5e-3)


def test_further_balls_show_what_the_first_left_open() -> None:
    about_x = CROSS.copy()
    about_x[:, 1] = -TILT * CROSS[:, 2]
    standing = MountPoseEstimate.nominal().with_found_balls(LINE, LINE).with_found_balls(CROSS, about_x)
    beside = np.array([[0.0, 100.0, 500.0]])
    expected = np.array([[0.0, 100.0 - TILT * 500.0, 500.0 + TILT * 100.0]])
    assert standing.transform(beside) == pytest.approx(expected, abs=1e-3)
