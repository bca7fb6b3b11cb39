"""Touch patterns: the information in their residuals, and the effect of a radius error on the centre."""

from __future__ import annotations

import numpy as np
import pytest

from twin.artefact.sphere_fit import fit_sphere
from twin.artefact.touch_pattern import (
    QUALIFYING_RINGS,
    RINGS,
    approach_directions,
    centre_covariance,
    centre_shift_per_radius,
    determines_radius,
    known_radius_covariance,
    redundancies,
    ring_directions,
)
from twin.errors import DataError

AXIS = np.array([0.0, 1.0, 0.0])
PATTERNS = [approach_directions(count, AXIS) for count in RINGS] + [ring_directions(QUALIFYING_RINGS, AXIS)]
names = [*(str(count) for count in RINGS), "qualifying"]


@pytest.mark.parametrize("directions", PATTERNS, ids=names)
def test_directions_are_unit_vectors_towards_the_ball_and_never_from_behind(directions: np.ndarray) -> None:
    assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(len(directions)))
    assert directions[0] == pytest.approx(AXIS)
    assert (directions @ AXIS >= -1e-12).all()
    apart = directions @ directions.T - 2.0 * np.eye(len(directions))
    assert apart.max() < 0.96


@pytest.mark.parametrize("count", [3, 5, 9, 13, 25])
def test_a_pattern_has_the_touches_it_is_named_by(count: int) -> None:
    assert len(approach_directions(count, AXIS)) == count


def test_another_pattern_is_refused() -> None:
    with pytest.raises(DataError, match="no pattern of 7"):
        approach_directions(7, AXIS)


def test_three_touches_need_the_radius_and_then_give_each_coordinate_the_noise_of_a_touch() -> None:
    three = approach_directions(3, AXIS)
    assert three @ three.T == pytest.approx(np.eye(3), abs=1e-12)
    assert not determines_radius(three)
    assert known_radius_covariance(three, 1e-3, 0.0) == pytest.approx(1e-6 * np.eye(3), abs=1e-12)
    with pytest.raises(DataError, match="3 touched points do not determine 4 unknowns"):
        centre_covariance(three, 1e-3)


@pytest.mark.parametrize("directions", PATTERNS[1:], ids=names[1:])
def test_redundancy_is_what_one_wrong_touch_leaves_of_itself_in_its_residual(directions: np.ndarray) -> None:
    """Push each touch by 1 µm alone and fit (brute force)."""
    shown = []
    for index in range(len(directions)):
        points = -15.5 * directions
        points[index] *= 1.0 + 1e-3 / 15.5
        shown.append(fit_sphere(points, 1e-3).residuals[index] / 1e-3)
    assert redundancies(directions) == pytest.approx(np.array(shown), abs=2e-4)
    assert redundancies(directions).sum() == pytest.approx(len(directions) - 4)


@pytest.mark.parametrize("directions", PATTERNS, ids=names)
def test_a_radius_known_too_large_moves_the_centre_as_stated(directions: np.ndarray) -> None:
    points = -15.5 * directions
    high, low = (fit_sphere(points, 1e-3, 15.5 + step, near=np.zeros(3)).centre for step in (1e-4, -1e-4))
    assert centre_shift_per_radius(directions) == pytest.approx((high - low) / 2e-4, abs=1e-4)


def test_known_radius_covariance_of_five_touches_is_that_of_hand_arithmetic() -> None:
    """Compare along the stylus (only the pole): σ² + u², against 1.25 σ² with a free radius. Across it ½ σ² in both
    cases.
    """
    sigma, radius_sigma = 2.0, 0.7
    fixed = known_radius_covariance(approach_directions(5, AXIS), sigma, radius_sigma)
    assert fixed == pytest.approx(np.diag([2.0, 4.0 + 0.49, 2.0]), abs=1e-9)
    free = centre_covariance(approach_directions(5, AXIS), sigma)
    assert free == pytest.approx(np.diag([2.0, 5.0, 2.0]), abs=1e-9)


def test_five_touches_leave_their_pole_unchecked() -> None:
    assert redundancies(approach_directions(5, AXIS)) == pytest.approx([0.0, 0.25, 0.25, 0.25, 0.25])
