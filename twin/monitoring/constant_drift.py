"""Test for errors of a machine that drift in one direction over many nights.

The hypothesis is that one error has changed by the same amount in every night since a certain first night: its m
coefficients by a vector r per night, with mean zero and the covariance Λ = RATE² I in units of the family. The nights
give r the score s and the information F (module `twin.identification.drift_trend`), and module
`twin.identification.jump` gives the likelihood ratio of the hypothesis against a machine that only walks randomly.

All errors and first nights are equally likely beforehand. The mean of their likelihood ratios has the expected value 1
in any night if the machine only walks as assumed, so it exceeds 1/α with a probability of at most α (Markov). First
nights after the last `MIN_NIGHTS` are left out: so short a drift cannot be distinguished from a sudden change.

The direction of the drift is not given beforehand: the test is two-sided. `SuspectedDrift.other_direction` is the
one-sided probability that the error drifts in the other direction than stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from twin.arrays import Array
from twin.identification.drift_trend import RATE, DriftRates, DriftStart, DriftTrend
from twin.identification.jump import (
    ERRORS,
    ErrorCoefficients,
    coefficients_of,
    jump_evidence,
    largest_false_alarm,
    log_mean_ratio,
)
from twin.identification.unknowns import Indices, Unknowns
from twin.machine.error_model import SQUARENESS
from twin.machine.legendre import legendre_values
from twin.units import MICRO_UNITS

MIN_NIGHTS = 4
"""Smallest number of measured nights in which a drift is told."""

FALSE_ALARM = 0.01
"""Largest probability with which a drift is found in a night although the machine only walks as assumed."""

_SHARE = 0.95  # probability of all named errors together
_TRAVEL_POINTS = 101


@dataclass(frozen=True)
class SuspectedDrift:
    """Geometric error that may drift in one direction; `error` is its ISO 230-1 name.

    `probability` is that of this error if one error drifts. `rate` is its change per night in `unit` if it drifts
    alone, and `standard_uncertainty` is that of the rate. For a squareness it is the change of the angle. For an error
    motion it is the peak-to-valley value of the change over the travel of the axis; it is negative if the change at the
    end of the travel is smaller than the change at the start. `other_direction` is the probability that the rate has
    the other sign.
    """

    error: str
    probability: float
    rate: float
    standard_uncertainty: float
    unit: str
    other_direction: float

    @property
    def text(self) -> str:
        """The drift in words, with its rate and the standard uncertainty of the rate."""
        return f"{self.error} by {self.rate:+.2g} ± {self.standard_uncertainty:.1g} {self.unit} a night"


@dataclass(frozen=True)
class FoundDrift:
    """Drift in one direction that the nights show.

    `nights` is the time since its likeliest first night, in nights. `false_alarm` is an upper limit of the probability
    that a machine without a drift shows as clear a one in the night in which it was found. `suspects` are the errors
    that may have drifted, the likeliest first; together they have a probability of 95 % or more.
    """

    nights: float
    false_alarm: float
    suspects: tuple[SuspectedDrift, ...]

    @property
    def text(self) -> str:
        """The drift in words, with the errors that may have caused it."""
        first, *others = self.suspects
        told = f"{first.text} for about {self.nights:.0f} nights ({100.0 * first.probability:.0f} %)"
        return "; or ".join((told, *(f"{one.text} ({100.0 * one.probability:.0f} %)" for one in others)))


@dataclass(frozen=True, eq=False)
class _Hypotheses:
    """Evidence (n, E) of a drift of each of E errors since each of n first nights."""

    coefficients: ErrorCoefficients
    starts: tuple[DriftStart, ...]
    evidence: Array

    @classmethod
    def of(cls, unknowns: Unknowns, trend: DriftTrend) -> _Hypotheses:
        coefficients = ErrorCoefficients.of(unknowns)
        starts = tuple(start for start in trend.starts if start.measured >= MIN_NIGHTS)
        evidence = [_evidence(coefficients, start.score, start.information) for start in starts]
        return cls(coefficients, starts, np.array(evidence).reshape(len(starts), len(coefficients.errors)))


def _evidence(coefficients: ErrorCoefficients, score: Array, information: Array) -> Array:
    columns, present = coefficients.columns, coefficients.present
    inner = information[columns[:, :, None], columns[:, None, :]] * present[:, :, None] * present[:, None, :]
    return jump_evidence(score[columns] * present, inner, RATE)[0]


def begun_drift(unknowns: Unknowns, before: DriftTrend, after: DriftTrend) -> tuple[DriftStart, DriftRates] | None:
    """Return the likeliest first night of a drift and the rates of the errors that may drift since then, both as known
    `before` the last night. The errors and the first night are chosen with the knowledge `after` it.

    The errors are the likeliest ones, with a probability of 95 % or more together if one error drifts. The result is
    None if the nights would show such a drift with a probability above `FALSE_ALARM` on a machine without one.
    """
    found = _Hypotheses.of(unknowns, after)
    if not found.starts:
        return None
    false_alarm = largest_false_alarm(log_mean_ratio(found.evidence))
    if false_alarm > FALSE_ALARM:
        return None
    odds = np.exp(found.evidence - found.evidence.max())
    start = before.since(found.starts[int(odds.sum(axis=1).argmax())])
    columns = [found.coefficients.of_error(number) for number in _named(odds.sum(axis=0))]
    return start, DriftRates.found(start, np.sort(np.concatenate(columns)), false_alarm)


def found_drift(unknowns: Unknowns, rates: DriftRates) -> FoundDrift:
    """Return the errors that may drift in the present night, given the `rates` of all errors that may do so."""
    score, information = rates.score, rates.information
    columns = {error: np.flatnonzero(np.isin(rates.columns, coefficients_of(unknowns, error))) for error in ERRORS}
    columns = {error: own for error, own in columns.items() if own.size}
    evidence = [float(jump_evidence(score[own], information[np.ix_(own, own)], RATE)[0]) for own in columns.values()]
    odds = np.exp(np.array(evidence) - max(evidence))
    odds /= odds.sum()
    errors = list(columns)
    suspects = [
        _suspect(unknowns, errors[number], rates.columns[own], score[own], information[np.ix_(own, own)], odds[number])
        for number in _named(odds)
        for own in [columns[errors[number]]]
    ]
    return FoundDrift(rates.nights, rates.false_alarm, tuple(suspects))


def still_drifts(rates: DriftRates) -> bool:
    """Return True if all nights together make a drift by the `rates` more likely than none."""
    return float(jump_evidence(rates.score, rates.information, RATE)[0]) > 0.0


def _named(odds: Array) -> list[int]:
    """Return the indices of the likeliest of n hypotheses with the given `odds` (n,), until they have a probability of
    95 % together."""
    ranked = np.argsort(-odds)
    count = int(np.searchsorted(np.cumsum(odds[ranked]) / odds.sum(), _SHARE)) + 1
    return [int(number) for number in ranked[:count]]


def _suspect(
    unknowns: Unknowns, error: str, columns: Indices, score: Array, information: Array, probability: float
) -> SuspectedDrift:
    covariance = np.linalg.inv(information + np.eye(len(columns)) / RATE**2)
    parameters = [unknowns.model.parameters[i] for i in columns]
    unit, factor = MICRO_UNITS[parameters[0].unit]
    scale = factor * unknowns.scale[columns]
    mean = covariance @ score
    weights = scale
    if error not in SQUARENESS:
        orders = [one.order for one in parameters]
        values = legendre_values(np.linspace(-1.0, 1.0, _TRAVEL_POINTS), max(orders))[orders]
        along = (scale * mean) @ values
        # difference of the highest and the lowest place, or the other way round: linear in the rates
        ends = np.sort([along.argmax(), along.argmin()])
        sign = 1.0 if (along[-1] >= along[0]) == (along[ends[1]] >= along[ends[0]]) else -1.0
        weights = scale * sign * (values[:, ends[1]] - values[:, ends[0]])
    rate, deviation = float(weights @ mean), float(np.sqrt(weights @ covariance @ weights))
    return SuspectedDrift(
        error, float(probability), rate, deviation, unit, float(ndtr(-abs(rate) / max(deviation, 1e-300)))
    )
