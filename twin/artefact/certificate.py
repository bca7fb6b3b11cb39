"""Knowledge about the ball centres of an artefact in addition to the values of its certificate: uncertified balls, a
common uncertainty of all lengths, and lengths that were measured independently."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

UNCERTIFIED_MM = 1.0
"""Standard uncertainty in mm of each coordinate of an uncertified ball. It exceeds any error of a centre that can be
touched, and the paths to the ball remain safe."""

_MAX_CONTRADICTION = 5.0
_PER_PPM = 1e-6


@dataclass(frozen=True)
class ReferenceLength:
    """Distance between the centres of two balls at the reference temperature, measured independently of the
    certificate, for example with a laser interferometer or a gauge block. Both values are in mm."""

    balls: tuple[int, int]
    length_mm: float
    standard_uncertainty_mm: float

    @property
    def text(self) -> str:
        """Description of the length for the record of the certificate."""
        first, second = self.balls
        return (
            f"length of balls {first} and {second} measured: {self.length_mm:.4f} mm, "
            f"standard uncertainty {1e3 * self.standard_uncertainty_mm:g} µm"
        )


def with_length_uncertainty(balls: Array, covariance: Array, uncertainty_ppm: float) -> Array:
    """Return the covariance (3N, 3N) in mm² of the centres `balls` (N, 3) with a common relative uncertainty of all
    lengths added."""
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
    widened[rows, :] = widened[:, rows] = 0.0
    widened[rows, rows] = UNCERTIFIED_MM**2
    return widened


def with_reference_lengths(balls: Array, covariance: Array, lengths: Sequence[ReferenceLength]) -> tuple[Array, Array]:
    """Return the centres (N, 3) in mm and their covariance (3N, 3N) in mm² after a Gaussian update by measured lengths.

    Each length is linearised along the line between its two balls. Raise DataError if a length contradicts the
    certificate, that is, if it differs by more than five standard deviations.
    """
    for length in lengths:
        balls, covariance = _updated(balls, covariance, length)
    return balls, covariance


def _updated(balls: Array, covariance: Array, length: ReferenceLength) -> tuple[Array, Array]:
    first, second = length.balls
    _check_ball(first, len(balls))
    _check_ball(second, len(balls))
    if first == second:
        raise DataError(f"a reference length needs two different balls, not ball {first} twice")
    line = balls[second] - balls[first]
    certified_mm = float(np.linalg.norm(line))
    # h(b) = |b₂ - b₁| with the gradient a; gain K = Σa / (aᵀΣa + u²); b + K (length - h), Σ - K aᵀΣ
    gradient = np.zeros(balls.size)
    gradient[3 * second : 3 * second + 3] = line / certified_mm
    gradient[3 * first : 3 * first + 3] = -line / certified_mm
    across = covariance @ gradient
    variance = float(gradient @ across) + length.standard_uncertainty_mm**2
    difference_mm = length.length_mm - certified_mm
    contradiction = abs(difference_mm) / math.sqrt(variance)
    if contradiction > _MAX_CONTRADICTION:
        raise DataError(
            f"the reference length of balls {first} and {second} is {length.length_mm:.4f} mm, but their centres are "
            f"{certified_mm:.4f} mm apart: {1e3 * difference_mm:+.1f} µm or {contradiction:.1f} standard deviations",
            hint="check both values and their temperature. If the scale of the certificate is in doubt, state it as "
            "length_standard_uncertainty_ppm: the reference length then corrects it. If one ball is in doubt, list it "
            "in uncertified_balls",
        )
    moved = balls + (across * (difference_mm / variance)).reshape(-1, 3)
    updated = covariance - np.multiply.outer(across, across) / variance
    return np.asarray(moved), np.asarray(0.5 * (updated + updated.T))


def _check_ball(ball: int, count: int) -> None:
    if not 0 <= ball < count:
        raise DataError(
            f"ball {ball} does not exist on an artefact with {count} balls",
            hint="balls are numbered from 0 in the order of the artefact file",
        )
