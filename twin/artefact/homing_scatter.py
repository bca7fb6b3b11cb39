"""Scatter of the homing of the axes: how far the displayed zero of an axis differs from homing to homing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.arrays import Array
from twin.artefact.homing_count import FEWEST_HOMINGS
from twin.artefact.repeatability import estimate_repeatability
from twin.errors import DataError


@dataclass(frozen=True)
class AxisScatter:
    """Standard deviation `sigma` of the zero of one axis from homing to homing, without that of the touches, `touches`.

    If both are normally distributed, the true standard deviation of the homing is between `lower` and `upper` with the
    probability `confidence`. All are in the unit of the centres.
    """

    sigma: float
    lower: float
    upper: float
    touches: float
    confidence: float


def homing_scatter(centres: Array, touch_sigma: Array, confidence: float = 0.95) -> tuple[AxisScatter, ...]:
    """Return the scatter of the homing of each axis from the centres (n, 3) of one ball, each measured after one of n
    homings.

    `touch_sigma` (3,) is the standard deviation of a centre that is measured repeatedly without a homing. The variances
    of homing and touches add up, so the second is subtracted from that of the centres, and from the limits of that
    variance, ν s² / χ² with ν = n - 1 degrees of freedom. A difference below zero shows a homing that scatters less
    than the touches can tell, and is stated as zero. Raises DataError if there are fewer than `FEWEST_HOMINGS` centres.
    """
    if len(centres) < FEWEST_HOMINGS:
        raise DataError(f"{len(centres)} homings do not show a scatter", hint=f"at least {FEWEST_HOMINGS} are needed")
    scatters = []
    for values, touches in zip(centres.T.tolist(), touch_sigma.tolist(), strict=True):
        total = estimate_repeatability(values, confidence)
        sigma, lower, upper = (_without(one, touches) for one in (total.sigma, total.lower, total.upper))
        scatters.append(AxisScatter(sigma, lower, upper, touches, confidence))
    return tuple(scatters)


def _without(total: float, part: float) -> float:
    return math.sqrt(max(total**2 - part**2, 0.0))
