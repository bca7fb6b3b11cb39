"""Formulation `distances` of the identification, the published method on which this project is based: the distances
between all pairs of balls in a position of the artefact are compared with the calibrated distances.

    |p_i - p_j| = |b_i(T) - b_j(T)|,   p = X + t + d(X; E)

Here i and j are the two balls of a pair, and p is the actual tool point at a ball. X is the axis position of the ball,
t the tool offset, d the deviation of the model with the parameters E, and b(T) the calibrated ball centre at
temperature T. Distances that share a ball are correlated, and not all pairwise distances of a position are independent.
With full weights, the distances of each position are whitened with the pseudo-inverse of their covariance (generalised
least squares). With unit weights, all distances have the same weight, as published.

A cut-off removes the poorly determined directions of the parameters from equations with unit weights (truncated
singular value decomposition). The singular values are those of the design matrix A = U S Vᵀ of the parameters in units
of the family. The columns V_r with singular values of at least the cut-off times the largest one are retained. With the
design A V_r V_rᵀ, the minimum-norm solution of the equations is V_r S_r⁻¹ U_rᵀ y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.errors import SingularSet
from twin.identification.poses import Poses
from twin.identification.problem import IdentificationProblem, Sides, tool_points

# Relative eigenvalue of the distances' covariance below which a combination of distances is redundant. Distances of
# balls on a line show their errors across it to second order only. Such combinations are not linear in errors of
# 0.05 mm, so they are left out if the artefact has no certificate.
_DEPENDENT, _DEPENDENT_IF_ROUGH = 1e-8, 1e-4


Rows = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class PositionPairs:
    """The m ball pairs of one position of the artefact.

    `first` and `second` (m,) are the row indices of the two balls of each pair; the rows (measured balls) are sorted by
    position. `whitening` (r, m) is the matrix that converts the m distances into r whitened equations.
    """

    first: Rows
    second: Rows
    whitening: Array


@dataclass(frozen=True, eq=False)
class DistanceEquations:
    """Whitened equations of all positions of the artefact, which compare measured with calibrated distances of balls.

    `white` (M, P) is the design matrix of the M whitened equations for the P unknowns. `noise` contains the noise
    covariance (r, r) of the r whitened equations of each position. `omitted` is the sum of the squared singular values
    that a cut-off removed, 0 without a cut-off.
    """

    problem: IdentificationProblem
    pairs: tuple[PositionPairs, ...]
    white: Array
    noise: tuple[Array, ...]
    matrix: Array
    rows: int
    omitted: float = 0.0

    @classmethod
    def build(
        cls, problem: IdentificationProblem, unit_weights: bool, cut_off: float | None = None
    ) -> DistanceEquations:
        points = tool_points(problem.observations)
        dependent = _DEPENDENT if problem.nuisance.errors.has_certificate else _DEPENDENT_IF_ROUGH
        unit = _unit_deviation(problem) if unit_weights else None
        pairs, white, noise = [], [], []
        ends = np.cumsum(problem.layout.counts).tolist()
        for start, end, design in zip([0, *ends[:-1]], ends, problem.design, strict=True):
            if end - start < 2:
                continue
            one, rows, covariance = _position(problem, points, (start, end), design[: end - start], unit, dependent)
            pairs.append(one)
            white.append(rows)
            noise.append(covariance)
        if not white:
            raise SingularSet("no position holds two balls, so there is no distance at all")
        stacked = np.concatenate(white)
        omitted = 0.0 if cut_off is None else _truncate(stacked[:, problem.blocks.parameters], cut_off)
        return cls(problem, tuple(pairs), stacked, tuple(noise), stacked.T @ stacked, len(stacked), omitted)

    def right_side(self, z: Array, sides: Sides, poses: Poses) -> tuple[Array, float, Poses]:
        """Return three values: the right side Aᵀy (P,) of the normal equations for the P unknowns, the square |y|², and
        the given `poses` of the artefact unchanged.

        A is the whitened design matrix, and y is the whitened right side of the equations, linearised at the unknowns
        z. `sides` contains the left and the right side of the exact equations at z, from which the exact distances
        follow. Poses have no effect on distances.
        """
        target = self.white @ z - self._remaining(sides)
        return self.white.T @ target, float(target @ target), poses

    def noise_gram(self, size: int) -> tuple[Array, float]:
        """Return the product AᵀCA (size, size) and the trace of C, which propagate the noise to an estimate with unit
        weights.

        A is the whitened design matrix of the first `size` unknowns, and C is the noise covariance of the whitened
        equations.
        """
        gram = np.zeros((size, size))
        start = 0
        for covariance in self.noise:
            rows = self.white[start : start + len(covariance), :size]
            gram += rows.T @ covariance @ rows
            start += len(covariance)
        return gram, float(sum(np.trace(covariance) for covariance in self.noise))

    def _remaining(self, sides: Sides) -> Array:
        """Return the whitened errors (M,) of the exact distances: measured minus calibrated distance."""
        left, local = sides
        errors = []
        for pair in self.pairs:
            found = np.linalg.norm(left[pair.first] - left[pair.second], axis=1)
            calibrated = np.linalg.norm(local[pair.first] - local[pair.second], axis=1)
            errors.append(pair.whitening @ (found - calibrated))
        return np.concatenate(errors)


def _position(
    problem: IdentificationProblem,
    points: Array,
    ends: tuple[int, int],
    design: Array,
    unit: float | None,
    dependent: float,
) -> tuple[PositionPairs, Array, Array]:
    """Return the ball pairs of one position, the whitened rows of their design, and the noise covariance of these rows.

    `ends` contains the index of the first row of the position, and the index of the first row after it. `design`
    (balls, 3, P) is the design of the rows of the position. `unit` is the common standard deviation of all distances in
    mm, or None for full weights. Combinations of distances with a relative variance below `dependent` are left out.
    """
    start, end = ends
    first, second = (index + start for index in np.triu_indices(end - start, k=1))
    # derivative of |p_i - p_j|: the unit vector of the pair for p_i, its negative for p_j
    line = points[first] - points[second]
    line /= np.linalg.norm(line, axis=1)[:, None]
    pick = np.zeros((len(first), end - start, 3))
    pair = np.arange(len(first))
    pick[pair, first - start], pick[pair, second - start] = line, -line
    covariance = problem.observations.covariance[start:end]
    # Propagation Lᵀ C L of the noise of the centres to the distances: the rows of L are the directions of the pairs,
    # with opposite signs at both ends.
    weighted = np.einsum("mic,icd->mid", pick, covariance).reshape(len(first), -1)
    flat = pick.reshape(len(first), -1)
    spread = weighted @ flat.T
    # m distances of n balls have at most 3n - 6 independent combinations (fewer on a line), so their covariance is
    # singular: hence the pseudo-inverse.
    whitening = _whitening(spread, dependent) if unit is None else np.eye(len(first)) / unit
    rows = whitening @ (flat @ design.reshape(3 * (end - start), -1))
    return PositionPairs(first, second, whitening), rows, whitening @ spread @ whitening.T


def _truncate(design: Array, cut_off: float) -> float:
    """Remove the directions with a singular value of less than `cut_off` times the largest one from a design matrix (M,
    p), in place. Return the sum of the squares of the removed singular values."""
    _, values, directions = np.linalg.svd(design, full_matrices=False)
    retained = directions[values >= cut_off * values[0]]
    # A V_r V_rᵀ
    design[:] = (design @ retained.T) @ retained
    return float(np.sum(values[len(retained) :] ** 2))


def _whitening(covariance: Array, dependent: float) -> Array:
    """Return W (r, m) such that WᵀW is the pseudo-inverse of a covariance (m, m). Directions with an eigenvalue below
    `dependent` times the largest one count as zero."""
    values, vectors = np.linalg.eigh(covariance)
    used = values > dependent * values[-1]
    return np.asarray((vectors[:, used] / np.sqrt(values[used])).T)


def _unit_deviation(problem: IdentificationProblem) -> float:
    """Return the standard deviation in mm that is used for all distances. It is the standard deviation of the
    difference of two typical coordinates."""
    variances = problem.observations.coordinate_variances_mm2
    # the variances of both ends of a distance add up along it
    return float(np.sqrt(2.0 * np.median(variances)))
