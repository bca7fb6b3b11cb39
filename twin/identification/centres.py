"""Formulation `centres`: ball centres with a free pose per position, eliminated by projection.

The covariance of each centre whitens its three equations; what the six pose increments of a position can do to its
whitened equations is an orthonormal basis of 3·balls × 6, so that projecting them out is one small product per position
(variable projection; Golub and Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.identification.poses import PoseProjector, Poses
from twin.identification.problem import Problem


@dataclass(frozen=True, eq=False)
class CentreEquations:
    """`white` (K, 3 width, P) whitened equations; `parts` (K·6, P) their projections on the pose increments."""

    problem: Problem
    whitening: Array
    projector: PoseProjector
    white: Array
    parts: Array
    matrix: Array
    rows: int

    @classmethod
    def build(cls, problem: Problem, unit_weights: bool) -> CentreEquations:
        layout = problem.layout
        whitening = _whitening(problem.observations.covariance, unit_weights)
        projector = PoseProjector.of(layout, problem.poses, problem.local, problem.arms, whitening)
        white = layout.pad(_weighted(whitening, problem.design)).reshape(layout.positions, -1, problem.blocks.size)
        parts = projector.parts(white).reshape(-1, problem.blocks.size)
        flat = white.reshape(-1, problem.blocks.size)
        return cls(
            problem=problem,
            whitening=whitening,
            projector=projector,
            white=white,
            parts=parts,
            matrix=flat.T @ flat - parts.T @ parts,
            rows=3 * problem.observations.size - projector.seen,
        )

    def right_side(self, z: Array, poses: Poses) -> tuple[Array, float, Poses]:
        """Aᵀy (P,) and |y|² for the exact residuals at z and at the poses that fit best there."""
        left, local = self.problem.sides(z)
        white = self._whitened(left - poses.place(self.problem.layout, local))
        poses = poses.moved(self.projector.increments(white), self.problem.arms)
        white = self._whitened(left - poses.place(self.problem.layout, local))
        target = self.white @ z - white
        parts = self.projector.parts(target[:, :, None]).reshape(-1)
        flat = target.reshape(-1)
        right = self.white.reshape(-1, len(z)).T @ flat - self.parts.T @ parts
        return right, float(flat @ flat - parts @ parts), poses

    def remaining(self, z: Array, poses: Poses) -> Array:
        """Whitened residuals (K, 3 width) at z without what the pose increments can take."""
        left, local = self.problem.sides(z)
        white = self._whitened(left - poses.place(self.problem.layout, local))
        return self.projector.remove(white[:, :, None])[:, :, 0]

    def noise_gram(self, size: int) -> tuple[Array, float]:
        """AᵀCA of the first `size` unknowns and trace C, C the covariance of the equations' noise."""
        layout = self.problem.layout
        shape = (layout.positions, layout.width, 3)
        found = layout.unpad(self.projector.remove(self.white[:, :, :size]).reshape(*shape, size))
        q = layout.unpad(self.projector.q.reshape(*shape, 6))
        noise = self.whitening @ self.problem.observations.covariance @ self.whitening.transpose(0, 2, 1)
        total = np.einsum("nii->", noise) - np.einsum("nij,nij->", q, noise @ q)
        return found.reshape(-1, size).T @ (noise @ found).reshape(-1, size), float(total)

    def _whitened(self, residuals: Array) -> Array:
        layout = self.problem.layout
        return layout.pad(_weighted(self.whitening, residuals[:, :, None])).reshape(layout.positions, -1)


def _whitening(covariance: Array, unit_weights: bool) -> Array:
    """(n, 3, 3) W with WᵀW = covariance⁻¹; with unit weights the same multiple of 1 for all rows."""
    variance = np.einsum("nii->ni", covariance)
    if unit_weights:
        return np.broadcast_to(np.eye(3) / np.sqrt(np.median(variance.mean(axis=1))), covariance.shape)
    if np.count_nonzero(covariance) == variance.size:
        return np.asarray(np.eye(3) / np.sqrt(variance)[:, :, None])
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _weighted(whitening: Array, rows: Array) -> Array:
    """W A for rows (n, 3, m); scaling alone where W is diagonal, as it is for one sigma per ball."""
    diagonal = np.einsum("nii->ni", whitening)
    if np.count_nonzero(whitening) == diagonal.size:
        return np.asarray(rows * diagonal[:, :, None])
    return np.asarray(whitening @ rows)
