"""Spacing of the balls along a bar: evenly, or unevenly by one of several rules.

With equal gaps, most distances between balls occur several times, and a motion error whose period is the gap looks the
same at each ball. An uneven spacing avoids both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

_LARGEST_OVER_SMALLEST = 2.0  # ratio of the gaps of a graded bar; a larger one leaves long parts without a ball
_GOLDEN_SHARE = 0.5 * (math.sqrt(5.0) - 1.0)


class BallSpacing(StrEnum):
    """Rule for the places of N balls along a bar of given length, whose end balls are at its ends.

    - EVEN: equal gaps.
    - GRADED: gaps that grow geometrically from one end to the other, the last twice as long as the first.
    - DISTINCT: gaps between one and two units in the order of the golden-ratio sequence, so that no two distances
      between balls are equal.
    - ENDS: Chebyshev-Lobatto points, which are denser towards the ends. They are the best places for the values of a
      polynomial.
    """

    EVEN = "even"
    GRADED = "graded"
    DISTINCT = "distinct"
    ENDS = "ends"


def spaced_balls(balls: int, length_mm: float, spacing: BallSpacing) -> Array:
    """Return the places (balls,) in mm of the balls along a bar, in rising order, measured from the middle of the bar.
    The first and the last are `length_mm` apart. Raises DataError for fewer than two balls or a length of 0."""
    if balls < 2:
        raise DataError(f"a ball bar needs at least two balls, got {balls}")
    if not 0.0 < length_mm < math.inf:
        raise DataError(f"the length of a ball bar must be positive, got {length_mm} mm")
    places = np.concatenate(([0.0], np.cumsum(_gaps(balls - 1, spacing))))
    shares = places / places[-1]
    shares[-1] = 1.0
    return np.asarray(length_mm * (shares - 0.5))


def stated_places(from_first_mm: Sequence[float]) -> Array:
    """Return the places (N,) in mm, measured from the middle of the bar, of balls whose distances from the first ball
    are `from_first_mm`. Raises DataError if they do not begin with 0 and rise."""
    places = np.asarray(from_first_mm, dtype=np.float64)
    if len(places) < 2 or places[0] != 0.0 or not np.isfinite(places).all() or not (np.diff(places) > 0.0).all():
        listed = ", ".join(f"{one:g}" for one in from_first_mm)
        raise DataError(
            f"the places of the balls, {listed} mm, do not begin with 0 and rise",
            hint="state the distance of each ball from the first one, such as 0,140,310,500",
        )
    return np.asarray(places - 0.5 * places[-1])


def _gaps(count: int, spacing: BallSpacing) -> Array:
    """Return `count` gaps between neighbouring balls in any unit."""
    numbers = np.arange(count)
    match spacing:
        case BallSpacing.EVEN:
            return np.ones(count)
        case BallSpacing.GRADED:
            return np.asarray(_LARGEST_OVER_SMALLEST ** (numbers / max(count - 1, 1)))
        case BallSpacing.DISTINCT:
            return np.asarray(1.0 + ((numbers + 1) * _GOLDEN_SHARE) % 1.0)
        case BallSpacing.ENDS:
            return np.diff(-np.cos(np.pi * np.arange(count + 1) / count))
