"""Test of each instrument against the ball centres and the other instruments.

The test needs no further identification: an estimate from the ball centres alone predicts the readings of every
instrument, with a covariance. What the readings of the others say is added to it by the linear update of a Gaussian
(Kalman). The residual of an instrument is then compared with its own covariance plus that of the prediction, after the
unknowns of its set-up have been fitted. If several instruments contradict, the one that contradicts most is left out
first, and the others are tested again without it: a wrong instrument makes the right ones look wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.special import chdtrc, ndtr

from twin.arrays import Array
from twin.identification.estimate import Estimate, Misfit
from twin.identification.instruments.check_result import InstrumentCheck, LargestResidual
from twin.identification.instruments.readings import InstrumentReadings, set_up_space, shared_errors
from twin.identification.instruments.rows import reading_covariance, reading_rows
from twin.identification.unknowns import Unknowns

FALSE_ALARM = 0.01
"""Probability that any of the instruments of an estimate is taken for wrong although all are right."""
_VISIBLE = 1e-6  # of the variance of a reading before the set-up is fitted: below it the set-up takes up the reading


class JointEstimate(Protocol):
    """Estimate of all unknowns with their covariance, computed or stored."""

    @property
    def unknowns(self) -> Unknowns: ...
    @property
    def z(self) -> Array: ...
    @property
    def z_covariance(self) -> Array: ...
    @property
    def misfit(self) -> Misfit | None: ...


def identify_with_instruments(
    identify_with: Callable[[tuple[InstrumentReadings, ...]], Estimate],
    instruments: Sequence[InstrumentReadings],
    *,
    keep_contradicting: bool = False,
) -> Estimate:
    """Return one estimate from the ball centres and those of the `instruments` that do not contradict, with the results
    of their tests. `identify_with` identifies the machine from the ball centres and the instruments it is given.

    The first identification, without instruments, predicts their readings and tells how large the errors of short
    wavelength are that they show besides. A contradicting instrument is joined only if `keep_contradicting` is True.
    """
    alone = identify_with(())
    checks = check_instruments(alone, instruments, keep_contradicting=keep_contradicting)
    chosen = tuple(one for one, check in zip(instruments, checks, strict=True) if check.joined)
    estimate = identify_with(with_unresolved(alone, chosen)) if chosen else alone
    return replace(estimate, instruments=checks)


def check_instruments(
    estimate: JointEstimate,
    instruments: Sequence[InstrumentReadings],
    *,
    keep_contradicting: bool = False,
    false_alarm: float = FALSE_ALARM,
) -> tuple[InstrumentCheck, ...]:
    """Return the results for all `instruments`, in their order. `estimate` is made from the ball centres alone.

    A contradicting instrument is joined only if `keep_contradicting` is True. The limit is `false_alarm` for all
    instruments together.
    """
    prepared = _prepared(with_unresolved(estimate, instruments), estimate.unknowns)
    limit = false_alarm / max(len(prepared), 1)
    trusted, found = set(range(len(prepared))), dict[int, InstrumentCheck]()
    while trusted:
        tested = {number: _tested_twice(estimate, prepared, number, trusted) for number in sorted(trusted)}
        # χ² tail probabilities of gross contradictions are all zero: χ² itself decides between them
        worst = min(tested, key=lambda number: (tested[number].false_alarm, -tested[number].chi2))
        if tested[worst].false_alarm >= limit:
            found |= tested
            break
        found[worst] = replace(tested[worst], contradicts=True, joined=keep_contradicting)
        trusted.remove(worst)
    return tuple(found[number] for number in range(len(prepared)))


def with_unresolved(
    estimate: JointEstimate, instruments: Sequence[InstrumentReadings]
) -> tuple[InstrumentReadings, ...]:
    """Return the instruments with the errors of short wavelength that `estimate` found on the machine."""
    unresolved_mm2 = 0.0 if estimate.misfit is None else estimate.misfit.unresolved_mm2
    return tuple(one.with_unresolved(unresolved_mm2) for one in instruments)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Instrument with its derivatives `rows` (m, P + d) and its `covariance` (m, m). The d errors that it shares with
    others of the same device are further unknowns with unit variance, and no part of the covariance."""

    readings: InstrumentReadings
    rows: Array
    covariance: Array


def _prepared(instruments: Sequence[InstrumentReadings], unknowns: Unknowns) -> list[_Prepared]:
    return [
        _Prepared(
            one,
            np.column_stack((reading_rows(one, unknowns), shared)),
            reading_covariance(one, unknowns) - shared @ shared.T,
        )
        for one, shared in zip(instruments, shared_errors(instruments), strict=True)
    ]


def _tested_twice(
    estimate: JointEstimate, prepared: Sequence[_Prepared], number: int, trusted: set[int]
) -> InstrumentCheck:
    """Return the result for one instrument against the ball centres and the other `trusted` instruments.

    If others were taken with the same device, they would explain an error of the device. The instrument is then tested
    without them too, and the result is the smaller of two probabilities, doubled (Bonferroni).
    """
    device, others = prepared[number].readings.device, trusted - {number}
    apart = {other for other in others if device is None or prepared[other].readings.device != device}
    found = _tested(estimate, prepared, number, others)
    if apart == others:
        return found
    found = min(found, _tested(estimate, prepared, number, apart), key=lambda one: (one.false_alarm, -one.chi2))
    return replace(found, false_alarm=min(1.0, 2.0 * found.false_alarm))


def _tested(estimate: JointEstimate, prepared: Sequence[_Prepared], number: int, others: set[int]) -> InstrumentCheck:
    """Return the result for one instrument against the ball centres and the `others`."""
    one = prepared[number]
    shared = one.rows.shape[1] - len(estimate.z)
    mean = np.pad(estimate.z, (0, shared))
    factor = np.pad(estimate.z_covariance, (0, shared))
    factor[len(estimate.z) :, len(estimate.z) :] = np.eye(shared)
    for other in sorted(others):
        mean, factor = _updated(mean, factor, prepared[other])
    residual = one.readings.readings - one.rows @ mean
    spread = one.covariance + one.rows @ factor @ one.rows.T
    lower = np.linalg.cholesky(spread)
    space = set_up_space(np.linalg.solve(lower, one.readings.free))
    white = np.linalg.solve(lower, residual)
    white = white - space @ (space.T @ white)
    chi2, freedom = float(white @ white), one.readings.size - space.shape[1]
    fitted = lower @ white
    carried = lower @ space
    variance = np.diagonal(spread) - np.square(carried).sum(axis=1)
    visible = variance > _VISIBLE * np.diagonal(spread)
    sigmas = np.divide(fitted, np.sqrt(np.maximum(variance, 1e-300)), out=np.zeros_like(fitted), where=visible)
    worst = int(np.abs(sigmas).argmax())
    unit = one.readings.unit(worst)
    largest = LargestResidual(one.readings.line(worst), float(sigmas[worst]), float(fitted[worst]), unit)
    # Bonferroni over the readings, and over both tests: χ² hardly notices one direction such as a wrong scale
    of_largest = 2.0 * one.readings.size * float(ndtr(-abs(sigmas[worst])))
    tail = min(1.0, 2.0 * min(float(chdtrc(freedom, chi2)), of_largest))
    kind = one.readings.kind
    return InstrumentCheck(one.readings.name, kind, one.readings.size, chi2, freedom, tail, largest, False, True)


def _updated(mean: Array, covariance: Array, seen: _Prepared) -> tuple[Array, Array]:
    """Return mean (P,) and covariance (P, P) of the unknowns after the readings of one instrument have been added."""
    complement = _without_set_up(seen.readings.free)
    rows, noise = complement.T @ seen.rows, complement.T @ seen.covariance @ complement
    carried = covariance @ rows.T
    gain = np.linalg.solve(rows @ carried + noise, carried.T).T
    residual = complement.T @ seen.readings.readings - rows @ mean
    updated = covariance - gain @ carried.T
    return mean + gain @ residual, 0.5 * (updated + updated.T)


def _without_set_up(free: Array) -> Array:
    """Return an orthonormal basis (m, m - r) of the combinations of readings that the set-up does not change."""
    space = set_up_space(free)
    whole = np.linalg.qr(space, mode="complete")[0] if space.size else np.eye(len(free))
    return np.asarray(whole[:, space.shape[1] :])
