"""Constant drift of single errors over many nights: what the nights say about it, and its use in the next prior.

From one night to the next, the P unknowns z of the identification walk randomly (process noise). An error that drifts
in one direction changes in addition by the same vector r in every night, from an unknown first night on. Let J select
the p parameters of the machine in z. If r is the change per night in these parameters, it displaces the true z from
the estimate of the nights, which does not know of it, by G r. With the time Δ between two nights, and with the
covariance C of z before a night, its score s and its information F (module `twin.monitoring.step_detection`), G is

    G⁻ = G + Δ J before the night,   G = (1 - C F) G⁻ after it,

because the measurement corrects the estimate. The night adds G⁻ᵀs to the score of r and G⁻ᵀF G⁻ to its information
(Willsky & Jones, IEEE Trans. Autom. Control 21, 1976). The balls of the night are not needed afterwards.

A drift that has been found becomes an unknown of the nights: rates r with mean, covariance V and the covariance X with
z. Before the next night, z moves by Δ J r, and its covariance grows accordingly (two-stage filter, Friedland, IEEE
Trans. Autom. Control 14, 1969). Rates fade with a time constant of `FADING_NIGHTS`, since no drift lasts for ever.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.identification.unknowns import Indices

RATE = 0.1
"""Standard deviation of a rate per night before anything is known about it, in standard deviations of the family."""

FADING_NIGHTS = 1000.0

UNEVENNESS = 1.0
"""Standard deviation of the walk per night of an error that drifts, in units of its change per night: no error drifts
by exactly the same amount in every night, and a walk may look like a drift for some time."""

MOST_STARTS = 5
"""Largest number of first nights whose sums are kept."""

LONGEST_NIGHTS = 90.0
"""Age, in nights, from which on the sums since a first night are dropped."""


@dataclass(frozen=True, eq=False)
class NightMeasurement:
    """Score (Q,), information (Q, Q) and prior covariance (Q, Q) of the Q unknowns of a night.

    The unknowns with the indices `before` (m,) in the estimate of the night before have the indices `now` (m,) among
    them. The estimate of this night keeps the first `kept` of them; the first `parameters` of these are the parameters
    of the machine.
    """

    score: Array
    information: Array
    covariance: Array
    before: Indices
    now: Indices
    kept: int
    parameters: int

    def carried(self, effect: Array) -> Array:
        """Return the rows (Q, n) of an `effect` (P, n) on the unknowns of the night before, for those of this night."""
        found = np.zeros((len(self.score), effect.shape[1]))
        found[self.now] = effect[self.before]
        return found

    def corrected(self, displaced: Array) -> Array:
        """Return the displacement of the unknowns from the estimate of this night. `displaced` (Q, n) is that from the
        prior; the rows of the result are those of the unknowns that are kept."""
        left = displaced - self.covariance @ (self.information @ displaced)
        return np.asarray(left[: self.kept])


@dataclass(frozen=True, eq=False)
class DriftStart:
    """Sums of the nights since one first night of a drift.

    `measured` is the number of nights in the sums, and `nights` is the time since the drift began, in nights. `effect`
    (P, p) is the displacement of the P unknowns from their estimate per unit of the rates of the p parameters. `score`
    (p,) and `information` (p, p) are those of the rates. All refer to the units of the unknowns.
    """

    measured: int
    nights: float
    effect: Array
    score: Array
    information: Array

    @classmethod
    def of_size(cls, unknowns: int, parameters: int) -> DriftStart:
        """Return the start of a drift that begins after the last night."""
        square = np.zeros((parameters, parameters))
        return cls(0, 0.0, np.zeros((unknowns, parameters)), np.zeros(parameters), square)

    def after_night(self, measurement: NightMeasurement, nights: float) -> DriftStart:
        """Return the sums with a further night, `nights` nights after the last one."""
        displaced = measurement.carried(self.effect)
        displaced[: measurement.parameters] += nights * np.eye(measurement.parameters)
        return DriftStart(
            self.measured + 1,
            self.nights + nights,
            measurement.corrected(displaced),
            self.score + displaced.T @ measurement.score,
            _symmetric(self.information + displaced.T @ measurement.information @ displaced),
        )


@dataclass(frozen=True, eq=False)
class DriftRates:
    """Rates of the errors that drift, as unknowns that the nights share.

    `columns` (k,) are the indices of the drifting parameters. `mean` (k,) and `covariance` (k, k) are those of their
    changes per night, and `cross` (P, k) is their covariance with the P unknowns; all are in the units of the unknowns.
    `nights` is the time since the likeliest first night of the drift. `false_alarm` is an upper limit of the
    probability with which a machine without a drift would have shown it as clearly in the night in which it was found.
    """

    columns: Indices
    mean: Array
    covariance: Array
    cross: Array
    nights: float
    false_alarm: float

    @classmethod
    def found(cls, start: DriftStart, columns: Indices, false_alarm: float) -> DriftRates:
        """Return the rates of the parameters `columns` (k,) if the drift began at `start`."""
        inner = start.information[np.ix_(columns, columns)]
        covariance = _symmetric(np.linalg.inv(inner + np.eye(len(columns)) / RATE**2))
        mean = covariance @ start.score[columns]
        cross = start.effect[:, columns] @ covariance
        return cls(columns, mean, covariance, cross, start.nights, false_alarm)

    @property
    def score(self) -> Array:
        """Score (k,) of the rates about zero, from all nights together."""
        return np.asarray(np.linalg.solve(self.covariance, self.mean))

    @property
    def information(self) -> Array:
        """Information (k, k) about the rates, from all nights together."""
        return _symmetric(np.linalg.inv(self.covariance) - np.eye(len(self.mean)) / RATE**2)

    @property
    def walk_variances(self) -> Array:
        """Variances (k,) per night of the walk of the drifting parameters about their drift."""
        return np.asarray(UNEVENNESS**2 * (self.mean**2 + np.diagonal(self.covariance)))

    def joined(self, more: DriftRates) -> DriftRates:
        """Return these rates together with `more` rates that were found later; rates of the same parameter add up."""
        columns = np.union1d(self.columns, more.columns)
        to_own, to_more = (np.equal.outer(columns, one.columns).astype(np.float64) for one in (self, more))
        return replace(
            self,
            columns=columns,
            mean=to_own @ self.mean + to_more @ more.mean,
            covariance=to_own @ self.covariance @ to_own.T + to_more @ more.covariance @ to_more.T,
            cross=self.cross @ to_own.T + more.cross @ to_more.T,
            false_alarm=min(self.false_alarm, more.false_alarm),
        )

    def predicted(self, nights: float) -> DriftRates:
        """Return the rates `nights` nights later, before the next measurement."""
        kept = math.exp(-nights / FADING_NIGHTS)
        moved = self.cross.copy()
        moved[self.columns] += nights * self.covariance
        size = len(self.mean)
        return replace(
            self,
            mean=kept * self.mean,
            covariance=kept**2 * self.covariance + (1.0 - kept**2) * RATE**2 * np.eye(size),
            cross=kept * moved,
            nights=self.nights + nights,
        )

    def after_night(self, measurement: NightMeasurement) -> DriftRates:
        """Return the predicted rates after the measurement of the night."""
        cross = measurement.carried(self.cross)
        return replace(
            self,
            mean=self.mean + cross.T @ measurement.score,
            covariance=_symmetric(self.covariance - cross.T @ measurement.information @ cross),
            cross=measurement.corrected(cross),
        )


@dataclass(frozen=True, eq=False)
class DriftTrend:
    """Knowledge about errors that drift in one direction, carried on from night to night.

    `starts` contains the sums for several first nights of a drift that has not been found yet, the earliest first.
    `rates` are the rates of the drift that has been found; None if there is none.
    """

    starts: tuple[DriftStart, ...] = ()
    rates: DriftRates | None = None

    def __bool__(self) -> bool:
        return bool(self.starts) or self.rates is not None

    @property
    def size(self) -> int | None:
        """Number of unknowns to which the trend refers; None if it is empty."""
        if self.rates is not None:
            return len(self.rates.cross)
        return len(self.starts[0].effect) if self.starts else None

    def after_night(self, measurement: NightMeasurement, nights: float) -> DriftTrend:
        """Return the sums with a further night, `nights` nights after the last one, for a drift that may have begun
        after that night, too. The rates must be the predicted ones."""
        begun = DriftStart.of_size(1 + int(measurement.before.max()), measurement.parameters)
        starts = [start.after_night(measurement, nights) for start in (*self.starts, begun)]
        rates = None if self.rates is None else self.rates.after_night(measurement)
        return DriftTrend(_thinned(starts), rates)

    def since(self, start: DriftStart) -> DriftStart:
        """Return the sums before the night with which those of `start` end."""
        return min(self.starts, key=lambda one: abs(one.measured - (start.measured - 1)))

    def without(self, index: int) -> DriftTrend:
        """Return the trend without the unknown `index`."""
        starts = tuple(replace(one, effect=np.delete(one.effect, index, axis=0)) for one in self.starts)
        rates = self.rates
        if rates is not None:
            rates = replace(rates, cross=np.delete(rates.cross, index, axis=0))
        return DriftTrend(starts, rates)


def _symmetric(matrix: ArrayLike) -> Array:
    found = np.asarray(matrix, dtype=np.float64)
    return np.asarray(0.5 * (found + found.T))


def _thinned(starts: Iterable[DriftStart]) -> tuple[DriftStart, ...]:
    """Return at most `MOST_STARTS` starts whose ages are spread evenly on a logarithmic scale.

    The choice depends on times alone, so that it does not change the probability of a false alarm.
    """
    left = [start for start in starts if start.nights <= LONGEST_NIGHTS]
    while len(left) > MOST_STARTS:
        gaps = [math.log(left[i - 1].nights / left[i + 1].nights) for i in range(1, len(left) - 1)]
        del left[1 + int(np.argmin(gaps))]
    return tuple(left)
