"""Formulation `centres` of the identification: each ball centre gives three equations. Each position of the artefact
has a free pose, which is eliminated by projection.

The three equations of a ball centre are whitened with the covariance of the centre. Small increments of the six pose
parameters of a position change its whitened equations. All such changes form a space with the orthonormal basis Q, a
matrix of shape (3·balls, 6). Projecting the equations onto the complement of this space takes one small product per
position (variable projection; Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.identification.poses import PoseProjector, Poses, pose_jacobian, weighted
from twin.identification.problem import IdentificationProblem, Sides

_LINEAR_MM = 1e-6  # smaller increments have a negligible second order (1e-15 mm); the first order is projected out
_POSITIONS = 16  # positions whitened at a time: few enough for the cache, enough for an efficient matrix product


@dataclass(frozen=True, eq=False)
class CentreEquations:
    """Whitened equations of the ball centres of K positions of the artefact, for P unknowns. Each position has room for
    `width` balls (the slots), and some slots may be empty.

    `weight` (K, width, 3, 3) contains the whitening matrix W of each slot, which is zero in empty slots. `parts` (K·6,
    P) contains QᵀWA, where A is the design matrix and Q is the orthonormal basis of the effects of pose increments. The
    whitened design WA is as large as the design itself. WA is computed in pieces when it is needed, because allocating
    memory for all of WA takes longer than the products.
    """

    problem: IdentificationProblem
    whitening: Array
    weight: Array
    projector: PoseProjector
    parts: Array
    matrix: Array
    rows: int

    @classmethod
    def build(cls, problem: IdentificationProblem, unit_weights: bool) -> CentreEquations:
        jacobian = pose_jacobian(problem.layout, problem.poses, problem.local, problem.arms)
        return cls.without(jacobian, problem, unit_weights)

    @classmethod
    def without(cls, jacobian: Array, problem: IdentificationProblem, unit_weights: bool) -> CentreEquations:
        """Build the equations from which the effects of increments are removed. The columns of `jacobian` (K, width, 3,
        m) are the derivatives of the points with respect to these increments."""
        layout = problem.layout
        whitening = _whitening(problem.observations.covariance, unit_weights)
        weight = layout.pad(whitening)
        projector = PoseProjector.of(layout, jacobian, weight)
        # QᵀWA is computed as (WᵀQ)ᵀA: Q has 6 columns, A hundreds, so WA is never formed
        carrier = weighted(weight.swapaxes(2, 3), projector.q.reshape(*weight.shape[:3], -1))
        by_position = problem.design.reshape(layout.positions, -1, problem.blocks.size)
        parts = carrier.reshape(projector.q.shape).transpose(0, 2, 1) @ by_position
        parts = parts.reshape(-1, problem.blocks.size)
        return cls(
            problem=problem,
            whitening=whitening,
            weight=weight,
            projector=projector,
            parts=parts,
            # (WA)ᵀ(1 - Q Qᵀ)(WA) = (WA)ᵀ(WA) - (QᵀWA)ᵀ(QᵀWA)
            matrix=_gram(weight, problem.design) - parts.T @ parts,
            # Each direction of a pose that the balls determine uses up one equation.
            rows=3 * problem.observations.size - projector.seen,
        )

    def right_side(self, z: Array, sides: Sides, poses: Poses) -> tuple[Array, float, Poses]:
        """Return three values: the right side Aᵀy (P,) of the normal equations for the P unknowns, the square |y|², and
        the poses of the artefact that fit best.

        A is the whitened design matrix, and y is the whitened right side of the equations, linearised at the unknowns
        z. `sides` contains the left and the right side of the exact equations at z.
        """
        layout = self.problem.layout
        left, local = sides
        white = self._whitened(left - poses.to_workpiece(layout, local))
        increments = self.projector.increments(white)
        poses = poses.moved(increments, self.problem.arms)
        # The first order of a pose change is projected out anyway; only a larger step leaves a second order behind.
        if np.abs(increments).max() > _LINEAR_MM:
            white = self._whitened(left - poses.to_workpiece(layout, local))
        # y = W (A z - exact residual): solving A z' = y gives the next iterate z' itself, not its step
        target = self._whitened(self.problem.change(z)) - white if z.any() else -white
        right, square = self._products(target)
        return right, square, poses

    def first_right_side(self) -> tuple[Array, Array]:
        """Return Aᵀy (P,) and the increments (K, m) of the least-squares fit at z = 0, without moving the poses."""
        problem = self.problem
        left, local = problem.sides(np.zeros(problem.blocks.size))
        white = self._whitened(left - problem.poses.to_workpiece(problem.layout, local))
        return self._products(-white)[0], self.projector.increments(white)

    def remaining(self, sides: Sides, poses: Poses) -> Array:
        """Return the whitened residuals (K, 3·width) of the K positions with up to `width` balls each, after the effect
        of small changes of the artefact's poses has been removed."""
        left, local = sides
        white = self._whitened(left - poses.to_workpiece(self.problem.layout, local))
        return self.projector.remove(white[:, :, None])[:, :, 0]

    def projected(self, size: int) -> Array:
        """Return the whitened design (n, 3, size) of the first `size` unknowns for all n measured balls, after the
        effect of small changes of the artefact's poses has been removed."""
        layout = self.problem.layout
        white = weighted(self.weight, self.problem.design[..., :size]).reshape(layout.positions, -1, size)
        white -= self.projector.q @ self.parts.reshape(layout.positions, 6, -1)[:, :, :size]
        return layout.unpad(white.reshape(*self.weight.shape[:3], size))

    def noise_gram(self, size: int) -> tuple[Array, float]:
        """Return the product AᵀCA (size, size) and the trace of C, which propagate the noise to an estimate with unit
        weights.

        A is the whitened design matrix of the first `size` unknowns, and C is the noise covariance of the whitened
        equations.
        """
        layout = self.problem.layout
        found = self.projected(size)
        q = layout.unpad(self.projector.q.reshape(*self.weight.shape[:3], 6))
        noise = self.whitening @ self.problem.observations.covariance @ self.whitening.transpose(0, 2, 1)
        # tr((1 - Q Qᵀ) C) = tr C - tr(Qᵀ C Q)
        total = np.einsum("nii->", noise) - np.einsum("nij,nij->", q, noise @ q)
        return found.reshape(-1, size).T @ (noise @ found).reshape(-1, size), float(total)

    def _products(self, target: Array) -> tuple[Array, float]:
        """Return Aᵀy (P,) and |y|² of a whitened right side y (K, 3 width) with the projector applied."""
        parts = self.projector.parts(target[:, :, None]).reshape(-1)
        scaled = weighted(self.weight.swapaxes(2, 3), target.reshape(*self.weight.shape[:3], 1)).reshape(-1)
        right = scaled @ self.problem.design.reshape(len(scaled), -1) - parts @ self.parts
        return right, float(np.vdot(target, target) - parts @ parts)

    def _whitened(self, residuals: Array) -> Array:
        layout = self.problem.layout
        return layout.pad(weighted(self.whitening, residuals[:, :, None])).reshape(layout.positions, -1)


def _whitening(covariance: Array, unit_weights: bool) -> Array:
    """Return the whitening matrices W (n, 3, 3) with WᵀW = covariance⁻¹. With unit weights, W is the same multiple of
    the unit matrix for all rows."""
    variance = np.einsum("nii->ni", covariance)
    if unit_weights:
        # The common factor does not change the estimate, but keeps χ² and the scale of the noise comparable with full
        # weights.
        return np.broadcast_to(np.eye(3) / np.sqrt(np.median(variance.mean(axis=1))), covariance.shape)
    # diagonal covariances, the usual case, need no factorisation
    if np.count_nonzero(covariance) == variance.size:
        return np.asarray(np.eye(3) / np.sqrt(variance)[:, :, None])
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _gram(weight: Array, design: Array) -> Array:
    """Return the Gram matrix (WA)ᵀ(WA) (P, P) for the whitening matrices W and the design A."""
    size = design.shape[-1]
    gram, room = np.zeros((size, size)), np.empty((_POSITIONS, *design.shape[1:]))
    for start in range(0, len(design), _POSITIONS):
        piece = design[start : start + _POSITIONS]
        white = weighted(weight[start : start + _POSITIONS], piece, room[: len(piece)]).reshape(-1, size)
        gram += white.T @ white
    return gram
