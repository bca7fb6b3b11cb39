"""Comparison of held-out positions with the prediction of an estimate of the machine errors.

Held-out positions of the artefact are measured but not used in the estimate. At each position, the calibrated artefact
is fitted rigidly to the measured ball centres, so the comparison does not depend on the pose of the artefact. The
residual of this fit is a deviation of the machine plus noise. The covariance of the residuals is the sum of the
covariances of the estimate, the stated model misfit, the calibrated ball centres and the touches.

The balls of a straight artefact are some micrometres off a line, so deviations of the machine of the same size turn the
fitted artefact about this line by any angle. Let u be the pattern of the certified distances from the line, and n × u
the pattern turned by a right angle about the direction n of the line. At every roll the pattern is a combination of
both. The test leaves out both, and its result therefore does not depend on the roll. Gravity bends the artefact
downwards at every roll.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.straight_line import position_frames
from twin.errors import DataError

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class HeldOutResiduals:
    """Residuals of held-out positions, which were measured but not used in the estimate, with n measured balls in
    total.

    `placed_mm` (n, 3) contains the calibrated ball centres after the best rigid fit to the measured centres.
    `residuals_mm` (n, 3) contains the measured centres minus these fitted centres. `rms_mm` is the root mean square
    residual of a ball, corrected for the degrees of freedom that the fitted poses use. `freedom` is the number of
    remaining degrees of freedom.
    """

    placed_mm: Array
    residuals_mm: Array
    rms_mm: float
    freedom: int


@dataclass(frozen=True)
class HeldOutTest:
    """Result of the χ² test of held-out residuals. These are the residuals of positions that were measured but not used
    in the estimate. `predicted_mm` is the rms residual expected from the covariance of the residuals. `chi2_normalised`
    is χ² per degree of freedom, and `freedom` is the number of degrees of freedom.
    """

    predicted_mm: float
    chi2_normalised: float
    freedom: int


@dataclass(frozen=True, eq=False)
class HeldOutCovariance:
    """Covariance of the residuals of n held-out balls, in the f directions that the poses leave free.

    `basis` (3n, f) contains orthonormal columns, each free of the pose of one position. The residuals of the balls,
    projected on them, have the covariance `touches` + `certificate` + `field`, each (f, f) in mm²: the noise of the
    touches, the errors of the calibrated ball centres, and those of the estimate with the model misfit.
    """

    basis: Array
    touches: Array
    certificate: Array
    field: Array

    @property
    def total(self) -> Array:
        return np.asarray(self.touches + self.certificate + self.field)

    @property
    def predicted_rms_mm(self) -> float:
        """Expected rms residual of a ball."""
        return float(np.sqrt(3.0 * np.trace(self.total) / self.basis.shape[1]))

    def projected(self, displacements_mm: Array) -> Array:
        """Return displacements (n, 3) of the balls in mm, projected on the f directions, (f,)."""
        return np.asarray(self.basis.T @ displacements_mm.reshape(-1))

    def test(self, residuals_mm: Array) -> HeldOutTest:
        """Compare the residuals (n, 3) in mm with those expected from their covariance."""
        left, covariance = self.projected(residuals_mm), self.total
        # r = Bᵀe, χ² = rᵀC⁻¹r
        chi2 = float(left @ np.linalg.solve(covariance, left))
        return HeldOutTest(self.predicted_rms_mm, chi2 / len(left), len(left))


def held_out_residuals(observations: Observations, tool_points: Array, artefact: Artefact) -> HeldOutResiduals:
    """Fit the calibrated artefact rigidly to the measured points of each position, and return the residuals.

    `tool_points` (n, 3) has one row for each row of `observations`. Each row is the position of the stylus centre in
    mm, in the workpiece frame, according to the controller. Raises DataError if a position has fewer than three balls.
    """
    placed = np.zeros((observations.size, 3))
    freedom = 0
    for rows in _by_position(observations):
        if len(rows) < 3:
            raise DataError(f"a position with {len(rows)} balls cannot be placed", hint="three are needed")
        placed[rows] = _placed(observations, artefact, rows, tool_points[rows])
        freedom += 3 * len(rows) - 6
    # Σr² / freedom estimates the variance of one coordinate, and a ball has three.
    residuals = tool_points - placed
    return HeldOutResiduals(placed, residuals, float(np.sqrt(3.0 / freedom * np.sum(residuals**2))), freedom)


def held_out_covariance(
    observations: Observations,
    placed_mm: Array,
    artefact: Artefact,
    field_covariance: Array,
    shared: Array | None = None,
) -> HeldOutCovariance:
    """Return the covariance of the residuals of n held-out balls with the calibrated centres `placed_mm` (n, 3).

    `field_covariance` (3n, 3n) is the covariance in mm² of the residual deviation at the n observed points, ordered
    point by point as x, y, z. It must contain only the contributions of the estimated machine parameters and of the
    model misfit. `shared` (3n, 3N) is the covariance in mm² of the residual deviation with the errors of the N ball
    centres, in the same order. It is None if the certificate is independent of the estimate.
    """
    n = observations.size
    rotations = np.zeros((3 * n, 3 * artefact.count))
    bases = []
    for rows in _by_position(observations):
        rotation = _rotation(_balls(observations, artefact, rows), placed_mm[rows])
        for row in rows:
            ball = int(observations.ball[row])
            rotations[3 * row : 3 * row + 3, 3 * ball : 3 * ball + 3] = rotation
        pattern = _pattern(observations, artefact, rows, rotation)
        bases.append(_pose_free_basis(_motions(placed_mm[rows], pattern), rows, n))
    basis = np.concatenate(bases, axis=1)
    field = field_covariance
    # the residual is the error of the centres minus the deviation, so what both have in common is subtracted twice
    if shared is not None:
        common = rotations @ shared.T
        field = field - (common + common.T)
    turned = basis.T @ rotations
    return HeldOutCovariance(
        basis,
        projected_touches(basis, observations.covariance),
        turned @ artefact.covariance @ turned.T,
        basis.T @ field @ basis,
    )


def projected_touches(basis: Array, covariance_mm2: Array) -> Array:
    """Return the covariance (f, f) in mm² of touches with the covariances (n, 3, 3) of n ball centres, projected on the
    columns of `basis` (3n, f)."""
    columns = basis.reshape(len(covariance_mm2), 3, -1)
    return np.asarray(basis.T @ (covariance_mm2 @ columns).reshape(basis.shape))


def _by_position(observations: Observations) -> list[Indices]:
    return [np.flatnonzero(observations.position == k) for k in np.unique(observations.position)]


def _placed(observations: Observations, artefact: Artefact, rows: Indices, points: Array) -> Array:
    """Return the calibrated centres (m, 3) in mm of the balls of one position, fitted rigidly to the measured `points`
    (m, 3)."""
    balls, sag = _balls(observations, artefact, rows), np.zeros_like(points)
    if artefact.sag_mm and position_frames(artefact, [observations.ball[rows]])[0] is not None:
        # the roll of a straight artefact is unknown, but not the direction of gravity: down, across the line
        numbers = observations.ball[rows]
        along = np.linalg.svd(points - points.mean(axis=0))[2][0]
        balls = artefact.without_sag(float(observations.temperature_c[rows].mean()))[numbers]
        sag = artefact.droop_mm[numbers, None] * (along * along[2] - [0.0, 0.0, 1.0])
    stiff = points - sag
    return np.asarray((balls - balls.mean(axis=0)) @ _rotation(balls, stiff).T + stiff.mean(axis=0) + sag)


def _balls(observations: Observations, artefact: Artefact, rows: Indices) -> Array:
    """Return calibrated centres (m, 3) mm in the artefact frame, at the temperature and elevation of these rows."""
    temperature = float(observations.temperature_c[rows].mean())
    balls: Array = artefact.at(temperature, float(observations.elevation_rad[rows[0]]))
    return balls[observations.ball[rows]]


def _rotation(balls: Array, points: Array) -> Array:
    """Return the rotation (3, 3) that best turns `balls` into `points`, both (m, 3) (Kabsch)."""
    u, _, vt = np.linalg.svd((points - points.mean(axis=0)).T @ (balls - balls.mean(axis=0)))
    rotation: Array = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation


def _pattern(observations: Observations, artefact: Artefact, rows: Indices, rotation: Array) -> Array | None:
    """Return the patterns u and n × u (m, 3, 2) in mm of the m balls of one position in the workpiece frame, at the
    roll of `rotation`. Return None if these balls do not stand on one line."""
    numbers = observations.ball[rows]
    (frame,) = position_frames(artefact, [numbers])
    if frame is None:
        return None
    certified = artefact.balls[numbers]
    lateral = (certified - certified.mean(axis=0)) @ frame[:, 1:]
    # n × turns the first lateral direction into the second one, and that into minus the first one
    turned = np.stack((-lateral[:, 1], lateral[:, 0]), axis=1)
    return np.asarray(np.einsum("ik,mkp->mip", rotation @ frame[:, 1:], np.stack((lateral, turned), axis=2)))


def _motions(placed: Array, pattern: Array | None) -> Array:
    """Return the displacements (m, 3, k) of the m `placed` balls (m, 3) that the pose takes up: six small rigid
    motions, or five of a straight artefact and its patterns u and n × u, of unit size."""
    arms = placed - placed.mean(axis=0)
    axes = np.eye(3)
    if pattern is not None:
        axes = np.linalg.svd(arms)[2][1:]  # across the line
    motions = np.zeros((len(placed), 3, 3 + len(axes)))
    motions[:, [0, 1, 2], [0, 1, 2]] = 1.0
    for number, axis in enumerate(axes):
        motions[:, :, 3 + number] = np.cross(axis, arms) / max(float(np.abs(arms).max()), 1e-9)
    if pattern is None:
        return motions
    size = float(np.linalg.norm(pattern[:, :, 0]))
    return motions if size == 0.0 else np.concatenate((motions, pattern / size), axis=2)


def _pose_free_basis(motions: Array, rows: Indices, count: int) -> Array:
    """Return orthonormal columns (3n, 3m - k) orthogonal to the displacements `motions` (m, 3, k) of the m balls of one
    position.

    n (`count`) is the number of all observed balls; `rows` are those of the position.
    """
    size = motions.shape[2]
    full, _ = np.linalg.qr(motions.reshape(-1, size), mode="complete")
    basis = np.zeros((3 * count, 3 * len(rows) - size))
    basis[(3 * rows[:, None] + np.arange(3)).reshape(-1)] = full[:, size:]
    return basis
