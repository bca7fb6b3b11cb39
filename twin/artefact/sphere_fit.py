"""Least-squares fit of a ball centre to touched points, with a known or a free radius and with the covariance of the
result.

The fit is a Gauss-Newton iteration on the geometric distances. It starts from the algebraic least-squares sphere, so
two steps are enough. The fit runs once per ball, also during a preflight. Each ball has only five to twenty-five
points. For so few points, sums of plain floats are faster than sums of arrays: for 5 points they took a quarter of the
time. LAPACK is used only to solve the 3×3 or 4×4 system of equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import dist, isfinite, sqrt

import numpy as np
from scipy.linalg.lapack import dposv, dpotri

from twin.arrays import Array
from twin.errors import DataError

_MAX_STEPS = 25
# A step reduces the error to about (residual / radius) < 1e-3 of itself; after a step this small only rounding is left.
_SMALL_STEP = 1e-7
_DEGENERATE = 1e-9  # smallest over largest squared Cholesky pivot of the scaled normal equations
_ROUNDING = 1e-7  # a spread below this part of the coordinates is rounding

Points = list[list[float]]


@dataclass(frozen=True, eq=False, slots=True)
class SphereFit:
    """Sphere fitted to n points, with its centre (3,), radius, form error and residuals (n,), all in mm.

    `covariance` is in mm². It is the covariance (3, 3) of the centre if the radius was known. If the radius was free,
    it is the covariance (4, 4) of centre and radius, with the radius last. A residual is the distance of a point from
    the centre minus the radius. `form` is the peak-to-valley value of the residuals.
    """

    centre: Array
    radius: float
    covariance: Array
    residuals: Array
    form: float

    @property
    def centre_covariance(self) -> Array:
        """Covariance (3, 3) of the centre in mm²."""
        return self.covariance[:3, :3]


def fit_sphere(points: Array, sigma_mm: float, radius: float | None = None, near: Array | None = None) -> SphereFit:
    """Fit a sphere to `points` (n, 3) in mm. Each point has the standard uncertainty `sigma_mm` along the surface
    normal.

    `radius` is the known radius in mm. If it is None, the radius is also estimated. If the radius is known and the
    points lie in one plane, there are two mirrored solutions. The solution closer to `near` (3,), a guess of the centre
    in mm, is then selected. Raises DataError if the points do not determine a sphere.
    """
    points = np.asarray(points, dtype=np.float64)
    _check(points, sigma_mm, radius)
    given: Points = points.tolist()
    # Relative to the mean and in units of the spread: the sums of squares then keep their digits far from the origin,
    # and the tolerances are relative.
    origin, spread = _frame(given)
    local = [[(value - middle) / spread for value, middle in zip(p, origin, strict=True)] for p in given]
    if near is None:
        start = _algebraic(local)
    else:
        start = [(float(value) - middle) / spread for value, middle in zip(near, origin, strict=True)]
    centre, fitted, factor = _gauss_newton(local, start, None if radius is None else radius / spread)
    residuals = [(dist(p, centre) - fitted) * spread for p in local]
    return SphereFit(
        centre=np.array([value * spread + middle for value, middle in zip(centre, origin, strict=True)]),
        radius=fitted * spread,
        covariance=_inverse(factor) * sigma_mm**2,
        residuals=np.array(residuals),
        form=max(residuals) - min(residuals),
    )


def _check(points: Array, sigma_mm: float, radius: float | None) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"touched points have the shape {points.shape}, expected (n, 3)")
    unknowns = 4 if radius is None else 3
    if len(points) < unknowns:
        raise DataError(
            f"{len(points)} touched points do not determine {unknowns} unknowns",
            hint="touch the ball more often, or give its radius",
        )
    if not isfinite(points.sum()):
        raise DataError("a touched point is not a finite number")
    if not sigma_mm > 0.0:
        raise DataError(f"the standard uncertainty of a touch must be positive, not {sigma_mm}")
    if radius is not None and not radius > 0.0:
        raise DataError(f"the radius must be positive, not {radius}")


def _frame(points: Points) -> tuple[list[float], float]:
    """Return the mean of the points (3 values) and their largest distance from it, in mm."""
    origin = [sum(values) / len(points) for values in zip(*points, strict=True)]
    spread = max(dist(p, origin) for p in points)
    if spread <= _ROUNDING * max(1.0, *map(abs, origin)):
        raise DataError("all touched points coincide", hint="touch the ball at different points")
    return origin, spread


def _algebraic(points: Points) -> list[float]:
    """Return the centre c of the algebraic sphere |p|² = 2 p·c + (r² - |c|²) fitted to the points p.

    r is the radius. The centre is exact if the points have no error.

    The points are given relative to their mean, so the constant drops out of the normal equations.
    """
    xx = xy = xz = yy = yz = zz = bx = by = bz = 0.0
    for x, y, z in points:
        squared = x * x + y * y + z * z
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        bx, by, bz = bx + x * squared, by + y * squared, bz + z * squared
    solution, _ = _solve([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], [bx, by, bz])
    return [0.5 * value for value in solution]


def _gauss_newton(points: Points, centre: list[float], radius: float | None) -> tuple[list[float], float, Array]:
    """Return the least-squares centre and radius in mm, and the Cholesky factor of the normal equations."""
    free = radius is None
    current = sum(dist(p, centre) for p in points) / len(points) if radius is None else radius
    for _ in range(_MAX_STEPS):
        step, factor = _step(points, centre, current, free)
        centre = [value + change for value, change in zip(centre, step, strict=False)]
        if free:
            current += step[3]
        if max(map(abs, step)) < _SMALL_STEP:
            return centre, current, factor
    raise DataError(
        "the touched points do not lie on a ball of this radius",
        hint="check the ball diameter and the stylus radius, and look for a false trigger",
    )


def _step(points: Points, centre: list[float], radius: float, free: bool) -> tuple[list[float], Array]:
    # Normal equations of the step: residual d - r, its gradient -(unit normal) for the centre, -1 for the radius.
    cx, cy, cz = centre
    xx = xy = xz = yy = yz = zz = sx = sy = sz = bx = by = bz = total = 0.0
    for px, py, pz in points:
        x, y, z = px - cx, py - cy, pz - cz
        distance = sqrt(x * x + y * y + z * z)
        if distance == 0.0:
            raise DataError("a touched point is at the centre of the ball")
        x, y, z, residual = x / distance, y / distance, z / distance, distance - radius
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        sx, sy, sz, total = sx + x, sy + y, sz + z, total + residual
        bx, by, bz = bx + x * residual, by + y * residual, bz + z * residual
    if not free:
        return _solve([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], [bx, by, bz])
    normal = [[xx, xy, xz, sx], [xy, yy, yz, sy], [xz, yz, zz, sz], [sx, sy, sz, float(len(points))]]
    return _solve(normal, [bx, by, bz, total])


def _solve(normal: list[list[float]], right: list[float]) -> tuple[list[float], Array]:
    """Return the solution of the normal equations and their lower Cholesky factor.

    Raises DataError if the equations are singular.
    """
    factor, solution, info = dposv(normal, right, lower=1)
    pivots = [float(factor[i, i]) ** 2 for i in range(len(right))]
    if info != 0 or min(pivots) < _DEGENERATE * max(pivots):
        raise DataError(
            "the touched points are coplanar or collinear and do not determine a ball centre",
            hint="spread the touches over the ball: the pole and a ring",
        )
    return solution.tolist(), factor


def _inverse(factor: Array) -> Array:
    lower: Array = np.asarray(dpotri(factor, lower=1)[0])
    for row in range(len(lower)):
        lower[row, row + 1 :] = lower[row + 1 :, row]
    return lower
