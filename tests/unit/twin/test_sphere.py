"""Sphere fits compared with constructed spheres and with scipy, and points that determine no sphere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from twin.artefact.sphere_fit import fit_sphere
from twin.errors import DataError

CENTRE = np.array([1234.5, -876.25, 310.125])
POLE_AND_RING = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float)


def around(directions: np.ndarray, radius: float = 14.0) -> np.ndarray:
    return CENTRE + radius * directions / np.linalg.norm(directions, axis=1)[:, None]


def test_points_without_error_give_the_sphere_back() -> None:
    for radius in (None, 14.0):
        fit = fit_sphere(around(POLE_AND_RING), 1e-3, radius)
        assert fit.centre == pytest.approx(CENTRE, abs=1e-9)
        assert fit.radius == pytest.approx(14.0, abs=1e-9)
        assert fit.form < 1e-9


def test_known_radius_covariance_is_that_of_hand_arithmetic() -> None:
    """Use touches along +Z, ±X, ±Y: the normal matrix is diag(2, 2, 1)/σ²."""
    fit = fit_sphere(around(POLE_AND_RING), 2e-3, 14.0)
    assert fit.covariance == pytest.approx(np.diag([0.5, 0.5, 1.0]) * 4e-6, abs=1e-14)


def test_free_radius_covariance_is_that_of_hand_arithmetic() -> None:
    """Use J = [u, 1]: z and r share [[1, 1], [1, 5]], whose inverse is [[5, -1], [-1, 1]]/4."""
    fit = fit_sphere(around(POLE_AND_RING), 1e-3)
    expected = np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.25, -0.25], [0, 0, -0.25, 0.25]])
    assert fit.covariance == pytest.approx(expected * 1e-6, abs=1e-14)
    assert fit.centre_covariance.shape == (3, 3)


@pytest.mark.parametrize("radius", [None, 14.0])
def test_noisy_points_agree_with_scipy(radius: float | None) -> None:
    rng = np.random.default_rng(4)
    points = around(rng.normal([0.0, 0.0, 1.0], 1.0, (25, 3))) + rng.normal(0.0, 5e-3, (25, 3))

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        size = unknowns[3] if radius is None else radius
        return np.linalg.norm(points - CENTRE - unknowns[:3], axis=1) - size

    start = [0.0, 0.0, 0.0, 13.0] if radius is None else [0.0, 0.0, 0.0]
    reference = least_squares(residuals, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    fit = fit_sphere(points, 5e-3, radius)
    assert fit.centre - CENTRE == pytest.approx(reference.x[:3], abs=1e-7)
    assert fit.residuals == pytest.approx(reference.fun, abs=1e-7)
    assert fit.form == pytest.approx(np.ptp(reference.fun), abs=1e-7)


def test_covariance_describes_the_scatter() -> None:
    rng = np.random.default_rng(5)
    directions = POLE_AND_RING + rng.normal(0.0, 0.2, POLE_AND_RING.shape)
    exact = around(directions)
    outward = (exact - CENTRE) / 14.0
    fits = [fit_sphere(exact + outward * rng.normal(0.0, 2e-3, (5, 1)), 2e-3, 14.0) for _ in range(3000)]
    scatter = np.cov(np.array([fit.centre for fit in fits]).T)
    assert scatter == pytest.approx(fits[0].covariance, rel=0.15, abs=2e-7)


def test_a_ring_needs_a_guess_which_side_the_centre_is_on() -> None:
    ring = np.array([[1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5], [0, -1, 0.5]])
    points = around(ring)
    guess = CENTRE + np.array([1.0, -1.0, 2.0])
    assert fit_sphere(points, 1e-3, 14.0, near=guess).centre == pytest.approx(CENTRE, abs=1e-9)
    with pytest.raises(DataError, match="coplanar"):
        fit_sphere(points, 1e-3, 14.0)


@pytest.mark.parametrize(
    ("points", "radius", "words"),
    [
        (around(POLE_AND_RING[:2]), 14.0, "2 touched points do not determine 3"),
        (around(POLE_AND_RING[:3]), None, "3 touched points do not determine 4"),
        (np.outer(np.arange(5.0), [1.0, 1.0, 1.0]), None, "collinear"),
        (np.tile(CENTRE, (5, 1)), 14.0, "coincide"),
        (np.full((5, 3), np.nan), 14.0, "not a finite"),
        (around(POLE_AND_RING), -1.0, "must be positive"),
        (around(POLE_AND_RING)[:, :2], 14.0, "shape"),
    ],
)
def test_points_that_fix_no_sphere(points: np.ndarray, radius: float | None, words: str) -> None:
    with pytest.raises(DataError, match=words):
        fit_sphere(points, 1e-3, radius)


def test_a_touch_without_uncertainty_is_refused() -> None:
    with pytest.raises(DataError, match="standard uncertainty"):
        fit_sphere(around(POLE_AND_RING), 0.0, 14.0)
