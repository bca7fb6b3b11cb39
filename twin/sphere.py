"""Centre of a ball from touched points: least squares with a known or a free radius, with covariance.

Gauss-Newton on the geometric distances, started from the algebraic sphere, so that two steps are enough. Runs once per
ball also in dry runs, so LAPACK is called directly on the 3×3 or 4×4 normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from twin.arrays import Array
from twin.errors import DataError

_MAX_STEPS = 25
_CONVERGED = 1e-10  # of the points' spread
_DEGENERATE = 1e-9  # smallest over largest squared Cholesky pivot of the scaled normal equations
_ROUNDING_PER_SPREAD = 1e-7


@dataclass(frozen=True, eq=False, slots=True)
class SphereFit:
    """`centre` (3,) mm; `radius` mm; `covariance` (3, 3) mm², or (4, 4) with the radius last where it was free;
    `residuals` (n,) mm, distance to the centre minus radius; `form` mm, peak to valley of the residuals."""

    centre: Array
    radius: float
    covariance: Array
    residuals: Array
    form: float

    @property
    def centre_covariance(self) -> Array:
        """(3, 3) mm²."""
        return self.covariance[:3, :3]


def fit_sphere(
    points: Array, sigma_mm: float, radius: float | None = None, near: Array | None = None
) -> SphereFit:
    """Sphere through `points` (n, 3) mm, each with the standard uncertainty `sigma_mm` along the surface normal.

    `radius` mm known, or None to estimate it. `near` (3,) mm, a guess of the centre, decides between the two mirror
    solutions when the points lie in one plane (known radius only). Raises DataError for points that fix no sphere.
    """
    points = np.asarray(points, dtype=np.float64)
    unknowns = 3 if radius is not None else 4
    _check(points, sigma_mm, radius, unknowns)
    origin = points.mean(axis=0)
    local = points - origin
    spread = float(np.abs(local).max())
    if spread <= _ROUNDING_PER_SPREAD * float(np.abs(origin).max()):
        raise DataError("all touched points coincide", hint="touch the ball at different places")
    local /= spread
    known = None if radius is None else radius / spread
    start = _algebraic(local) if near is None else (np.asarray(near, dtype=np.float64) - origin) / spread
    centre, fitted, normal, residuals = _gauss_newton(local, start, known)
    inverse = _inverse(normal)
    return SphereFit(
        centre=centre * spread + origin,
        radius=fitted * spread,
        covariance=inverse * sigma_mm**2,
        residuals=residuals * spread,
        form=float(residuals.max() - residuals.min()) * spread,
    )


def _check(points: Array, sigma_mm: float, radius: float | None, unknowns: int) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"touched points have the shape {points.shape}, expected (n, 3)")
    if len(points) < unknowns:
        raise DataError(
            f"{len(points)} touched points cannot fix {unknowns} unknowns",
            hint="touch the ball more often, or give its radius",
        )
    if not np.isfinite(points).all():
        raise DataError("a touched point is not a finite number")
    if not sigma_mm > 0.0:
        raise DataError(f"the standard uncertainty of a touch must be positive, not {sigma_mm}")
    if radius is not None and not radius > 0.0:
        raise DataError(f"the radius must be positive, not {radius}")


def _algebraic(points: Array) -> Array:
    """Centre (3,) of the algebraic sphere |p|² = 2 p·c + (r² - |c|²), exact for points without error."""
    design = np.empty((len(points), 4))
    design[:, :3] = 2.0 * points
    design[:, 3] = 1.0
    squared = np.einsum("ni,ni->n", points, points)
    return np.asarray(_solve(design.T @ design, design.T @ squared)[:3])


def _gauss_newton(points: Array, centre: Array, radius: float | None) -> tuple[Array, float, Array, Array]:
    """Centre, radius, normal matrix and residuals at the least-squares solution, in units of the spread."""
    free = radius is None
    design = np.empty((len(points), 4 if free else 3))
    for _ in range(_MAX_STEPS):
        offset = points - centre
        distance = np.sqrt(np.einsum("ni,ni->n", offset, offset))
        if not distance.min() > 0.0:
            raise DataError("a touched point lies in the centre of the ball")
        if radius is None:
            radius = float(distance.mean())
        design[:, :3] = offset / distance[:, None]
        if free:
            design[:, 3] = 1.0
        residuals = distance - radius
        normal = design.T @ design
        step = _solve(normal, design.T @ residuals)
        if float(np.abs(step).max()) < _CONVERGED:
            return centre, radius, normal, residuals
        centre = centre + step[:3]
        radius = radius + float(step[3]) if free else radius
    raise DataError(
        "the touched points do not lie on a ball of this radius",
        hint="check the ball diameter and the stylus radius, and look for a false touch",
    )


def _factor(normal: Array) -> Array:
    factor, info = dpotrf(normal, lower=1)
    pivots = np.diagonal(factor)
    if info != 0 or pivots.min() ** 2 < _DEGENERATE * pivots.max() ** 2:
        raise DataError(
            "the touched points lie in one plane or on one line and fix no ball centre",
            hint="spread the touches over the ball: the pole and a ring",
        )
    return np.asarray(factor)


def _solve(normal: Array, right: Array) -> Array:
    return np.asarray(dpotrs(_factor(normal), right, lower=1)[0])


def _inverse(normal: Array) -> Array:
    inverse = np.asarray(dpotri(_factor(normal), lower=1)[0])
    lower = np.tril(inverse)
    return lower + np.tril(inverse, -1).T
