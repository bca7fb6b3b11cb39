"""Knowledge about the ball centres of an artefact in addition to the values of its certificate: uncertified balls, a
common uncertainty of all lengths, and lengths that were measured independently.

An artefact whose ball centres are known only roughly has no certificate. Its identification needs a length that was
measured independently, since no other information gives the scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.rigid_motion import rigid_fields

UNCERTIFIED_MM = 1.0
"""Standard uncertainty in mm of each coordinate of an uncertified ball. It exceeds any error of a centre that can be
touched, and the paths to the ball remain safe."""

CERTIFIED_MM = 0.01
"""Largest standard uncertainty in mm per coordinate of the balls of a calibrated artefact. If the balls are known less
well, the uncertainty exceeds the errors of the machines that the artefact is to show."""

TRACEABLE_PPM = 10.0
"""Largest relative standard uncertainty, in ppm, of the best-known length of an artefact that gives a scale."""

REFERENCE_RANGE_C = (15.0, 25.0)
"""Lowest and highest reference temperature in °C of a calibration."""

MAX_CTE_PER_K = 1e-4
"""Largest thermal expansion in 1/K of a solid, and its largest standard uncertainty."""

_MAX_SCORE = 2.5
_COVERAGE_FACTOR = 2.0
_PER_PPM = 1e-6
_INDEPENDENT = 1e-9  # smallest singular value, relative to the largest, of an independent motion
_EXACT_MM = 1e-5  # least uncertainty of a centre: an exact certificate has no weight otherwise
_SAME_LENGTH_MM = 1.0  # two distances that differ by less could both be meant by the length of the end balls


@dataclass(frozen=True)
class BallDistance:
    """Distance between the centres of two balls at the reference temperature, with its standard uncertainty, both in
    mm. It was measured independently of the certificate, for example with a laser interferometer or a gauge block, or
    follows from the centres."""

    balls: tuple[int, int]
    length_mm: float
    standard_uncertainty_mm: float

    @property
    def ppm(self) -> float:
        """Relative standard uncertainty in ppm."""
        return self.standard_uncertainty_mm / self.length_mm / _PER_PPM

    @property
    def text(self) -> str:
        """Description of a measured length for the record of the certificate."""
        first, second = self.balls
        return (
            f"length of balls {first} and {second} measured: {self.length_mm:.4f} mm, "
            f"standard uncertainty {1e3 * self.standard_uncertainty_mm:g} µm"
        )


def end_balls(balls: Array) -> tuple[int, int]:
    """Return the numbers of the two balls that are farthest apart, of centres `balls` (N, 3) in mm. Raise DataError if
    another pair is as far apart within 1 mm."""
    pairs = farthest_pairs(balls)[:2]
    lengths = [float(np.linalg.norm(balls[second] - balls[first])) for first, second in pairs]
    if len(lengths) > 1 and lengths[1] > lengths[0] - _SAME_LENGTH_MM:
        named = " and ".join(f"{first}-{second}" for first, second in pairs)
        raise DataError(
            f"the artefact has no two end balls: the pairs {named} are both {lengths[0]:.1f} mm apart",
            hint="name the two balls of the length in a section [[reference_lengths]] instead",
        )
    return pairs[0]


def farthest_pairs(balls: Array) -> list[tuple[int, int]]:
    """Return the numbers of the two balls of each pair of centres `balls` (N, 3), the pair with the largest distance
    first."""
    first, second = np.triu_indices(len(balls), k=1)
    order = np.argsort(-np.linalg.norm(balls[second] - balls[first], axis=1), kind="stable")
    return list(zip(first[order].tolist(), second[order].tolist(), strict=True))


def has_certificate(balls: Array, covariance: Array) -> bool:
    """Return True if the shape of the artefact is known to `CERTIFIED_MM` at half of its balls or more.

    `balls` (N, 3) in mm and `covariance` (3N, 3N) in mm² are the centres and their covariance. Uncertainties of the
    artefact's frame and of a common scale do not count.
    """
    # A length can be certified although the scale is poor, and a frame is a convention: neither is part of the shape.
    fields = _motions(balls, scale=True)
    # The motion is fitted with the weights of the covariance, C - F (Fᵀ C⁻¹ F)⁻¹ Fᵀ: fitted with equal weights, a ball
    # that is not certified would carry its uncertainty into all others.
    weighted = np.linalg.solve(covariance + _EXACT_MM**2 * np.eye(balls.size), fields)
    left = covariance - fields @ np.linalg.solve(fields.T @ weighted, fields.T)
    variances = np.diagonal(left).reshape(-1, 3).mean(axis=1)
    return bool(np.median(variances) <= CERTIFIED_MM**2)


def without_motions(balls: Array, *, scale: bool = False) -> Array:
    """Return the projector (3N, 3N) that removes small rigid motions from displacements of the centres `balls` (N, 3)
    and, if `scale` is True, a common scale as well."""
    seen = _motions(balls, scale=scale)
    return np.asarray(np.eye(balls.size) - seen @ seen.T)


def _motions(balls: Array, *, scale: bool) -> Array:
    """Return an orthonormal basis (3N, m) of the displacements of the centres `balls` (N, 3) by small rigid motions
    and, if `scale` is True, by a common scale."""
    arms = balls - balls.mean(axis=0)
    size_mm = float(np.abs(arms).max())
    fields = rigid_fields(arms, np.zeros(3), size_mm).reshape(balls.size, -1)
    if scale:
        fields = np.column_stack((fields, arms.reshape(-1) / size_mm))
    # the rotation of a straight artefact about its line displaces no ball, so its column may be zero
    basis, values, _ = np.linalg.svd(fields, full_matrices=False)
    return np.asarray(basis[:, values > _INDEPENDENT * values[0]])


def best_known_length(balls: Array, covariance: Array) -> BallDistance:
    """Return the distance between two balls with the smallest relative standard uncertainty, for centres `balls` (N, 3)
    in mm with the covariance (3N, 3N) in mm²."""
    lengths = (
        known_length(balls, covariance, (first, second))
        for first in range(len(balls))
        for second in range(first + 1, len(balls))
    )
    return min(lengths, key=lambda length: (length.ppm, -length.length_mm))


def known_length(balls: Array, covariance: Array, pair: tuple[int, int]) -> BallDistance:
    """Return the distance between the two balls `pair`. The other arguments are those of `best_known_length`."""
    gradient, length_mm = _gradient(balls, *pair)
    return BallDistance(pair, length_mm, math.sqrt(max(float(gradient @ covariance @ gradient), 0.0)))


def with_length_uncertainty(balls: Array, covariance: Array, uncertainty_ppm: float) -> Array:
    """Return the covariance (3N, 3N) in mm² of the centres `balls` (N, 3) with a common relative uncertainty of all
    lengths added."""
    # a common strain ε displaces every centre by ε times its vector from the middle: covariance u² a aᵀ
    arms = (balls - balls.mean(axis=0)).reshape(-1)
    return np.asarray(covariance + (uncertainty_ppm * _PER_PPM) ** 2 * np.multiply.outer(arms, arms))


def with_uncertified(covariance: Array, balls: Sequence[int]) -> Array:
    """Return the covariance (3N, 3N) in mm² of the centres, in which those of `balls` are known to `UNCERTIFIED_MM`
    only. Raise DataError for a ball that does not exist, or if fewer than three certified balls are left."""
    count = len(covariance) // 3
    for ball in balls:
        _check_ball(ball, count)
    if balls and count - len(set(balls)) < 3:
        raise DataError(
            f"{len(set(balls))} of {count} balls are uncertified, but at least three must be certified",
            hint="the artefact needs a new calibration",
        )
    widened = covariance.copy()
    rows = np.array([3 * ball + axis for ball in balls for axis in range(3)], dtype=np.int64)
    # Correlations with the certified balls would carry the doubt over to them.
    widened[rows, :] = widened[:, rows] = 0.0
    widened[rows, rows] = UNCERTIFIED_MM**2
    return widened


def with_reference_length(balls: Array, covariance: Array, length: BallDistance) -> tuple[Array, Array]:
    """Return the centres (N, 3) in mm and their covariance (3N, 3N) in mm², updated by a measured length.

    The update is Gaussian and linear along the line between the two balls. Raise DataError if the length contradicts
    the certificate, that is, if the score |E_n| of ISO 13528 (k = 2) exceeds 2.5.
    """
    # h(b) = |b₂ - b₁| with the gradient a; gain K = Σa / (aᵀΣa + u²); b + K (length - h), Σ - K aᵀΣ
    _, difference_mm, across, variance = _checked_length(balls, covariance, length)
    moved = balls + (across * (difference_mm / variance)).reshape(-1, 3)
    updated = covariance - np.multiply.outer(across, across) / variance
    return np.asarray(moved), np.asarray(0.5 * (updated + updated.T))


def with_reference_lengths(
    balls: Array, covariance: Array, lengths: Sequence[BallDistance], length_covariance: Array
) -> tuple[Array, Array]:
    """Return the same as `with_reference_length` for M lengths at once with their covariance (M, M) in mm²."""
    checked = [_checked_length(balls, covariance, length) for length in lengths]
    gradients = np.stack([gradient for gradient, *_ in checked])
    differences = np.array([difference for _, difference, *_ in checked])
    # the same with matrices: gain K = ΣAᵀ (AΣAᵀ + V)⁻¹
    across = covariance @ gradients.T
    gain = np.linalg.solve(gradients @ across + length_covariance, across.T).T
    updated = covariance - gain @ across.T
    return np.asarray(balls + (gain @ differences).reshape(-1, 3)), np.asarray(0.5 * (updated + updated.T))


def _checked_length(balls: Array, covariance: Array, length: BallDistance) -> tuple[Array, float, Array, float]:
    """Return the derivatives (3N,) of a length, its difference in mm from that of the centres, the derivatives times
    the covariance, and the variance in mm² of the difference. Raise DataError as `with_reference_length` does."""
    first, second = length.balls
    _check_ball(first, len(balls))
    _check_ball(second, len(balls))
    if first == second:
        raise DataError(f"a reference length needs two different balls, not ball {first} twice")
    gradient, certified_mm = _gradient(balls, first, second)
    across = covariance @ gradient
    variance = float(gradient @ across) + length.standard_uncertainty_mm**2
    difference_mm = length.length_mm - certified_mm
    score = abs(difference_mm) / (_COVERAGE_FACTOR * math.sqrt(variance))
    if score > _MAX_SCORE:
        raise DataError(
            f"the reference length of balls {first} and {second} is {length.length_mm:.4f} mm, but their centres are "
            f"{certified_mm:.4f} mm apart: {1e3 * difference_mm:+.1f} µm, |E_n| = {score:.2f} (k = 2)",
            hint="check both values and their temperature. If the scale of the certificate is in doubt, state it as "
            "length_standard_uncertainty_ppm: the reference length then corrects it. If one ball is in doubt, list it "
            "in uncertified_balls",
        )
    return gradient, difference_mm, across, variance


def _gradient(balls: Array, first: int, second: int) -> tuple[Array, float]:
    """Return the derivatives (3N,) of the distance between two balls with respect to all coordinates, and the distance
    in mm."""
    line = balls[second] - balls[first]
    length_mm = float(np.linalg.norm(line))
    gradient = np.zeros(balls.size)
    gradient[3 * second : 3 * second + 3] = line / length_mm
    gradient[3 * first : 3 * first + 3] = -line / length_mm
    return gradient, length_mm


def _check_ball(ball: int, count: int) -> None:
    if not 0 <= ball < count:
        raise DataError(
            f"ball {ball} does not exist on an artefact with {count} balls",
            hint="balls are numbered from 0 in the order of the artefact file",
        )
