"""Decision rule for a predicted error and a tolerance, after ISO 14253-1:2017 with a conformance probability limit of
97.5 % instead of the default of 95 %.

A feature is stated to conform only if the probability that its error is outside the tolerance is at most 2.5 %, and
stated not to conform only if the probability that it is inside is at most 2.5 %. For an error with a normal
distribution and one limit, conformity is stated up to the limit minus 1.96 standard uncertainties, which is close to
the guard band U (k = 2) of former editions. In between, nothing is stated.
"""

from __future__ import annotations

from enum import StrEnum

MAXIMUM_RISK = 0.025
"""Largest probability of a wrong statement about one feature."""


class Conformity(StrEnum):
    """Statement about a feature and its tolerance."""

    CONFORMS = "conforms"
    DOES_NOT_CONFORM = "does not conform"
    UNDECIDED = "undecided"
    NO_TOLERANCE = "no tolerance"


def decide(least_inside: float, most_inside: float) -> Conformity:
    """Return what may be stated about an error that lies inside its tolerance with a probability between
    `least_inside` and `most_inside`."""
    if 1.0 - least_inside <= MAXIMUM_RISK:
        return Conformity.CONFORMS
    return Conformity.DOES_NOT_CONFORM if most_inside <= MAXIMUM_RISK else Conformity.UNDECIDED


def decide_by_limits(lower: float, upper: float, tolerance: float | None) -> Conformity:
    """Return what may be stated about a quantity without sign that lies between `lower` and `upper`, its limits of
    coverage, where it must not exceed `tolerance`."""
    if tolerance is None:
        return Conformity.NO_TOLERANCE
    if upper <= tolerance:
        return Conformity.CONFORMS
    return Conformity.DOES_NOT_CONFORM if lower > tolerance else Conformity.UNDECIDED
