"""Power of a verification: the smallest sudden change (step) of an error that a few positions find.

A verification measures ball centres y = A z + noise, where z are the P unknowns of the identification with the
covariance C, which contains the uncertainty of the last estimate, of the certificate and of the drift since then. They
are correlated: what is not known of the certificate cancels in a position that was measured before. With the rows W of
all positions, scaled to unit noise and with the poses projected out, the information about a step of z is

    F = Wᵀ(I + W C Wᵀ)⁻¹W.

The test of the verification (module `twin.identification.jump`) reports an error with k coefficients if its evidence,
the natural logarithm of the likelihood ratio, reaches a limit l. Let φ be the eigenvalues of the k by k block of F, and
x the score in their eigenvectors, divided by √φ. After a step a it is normal with the mean √φ a and unit variance, and
the condition is

    Σ φ/(1 + φ) x² ≥ 2 l + Σ ln(1 + φ).

The left side is a weighted sum of noncentral χ² variables with one degree of freedom each; of a squareness it is one
such variable. False alarms of all errors are added up, which gives an upper bound (Bonferroni).

A step has the smoothest shape that its error can have, its term of lowest order: an angle for a squareness, a straight
line along the travel for a rotation or a positioning error, a parabola for a straightness. Its size is the change of
the angle, or the peak-to-valley value over the travel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.identification.jump import ERRORS, coefficients_of
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ERROR_MOTIONS, SQUARENESS
from twin.machine.legendre import legendre_values
from twin.uncertainty.quadratic_distribution import QuadraticDistribution, root_between
from twin.units import MICRO_UNITS

FALSE_ALARM, POWER = 0.01, 0.95
"""Probability of a false alarm of a whole verification, and probability with which a step is found."""

ROTATIONS = tuple(error for error in ERROR_MOTIONS if error[1] in "ABC")
"""The nine error motions that are rotations."""

_TRAVEL_POINTS = 201
_UNSEEN = 1e-9  # noncentrality of a step of one standard deviation below which no size of it would be found
_LARGEST = 1e6  # size in µm or µrad above which a step counts as not found
_LARGEST_EVIDENCE = 50.0
_SIZE_TOLERANCE = 1e-6  # µm or µrad
_ENOUGH = 30.0  # noncentrality with which a step is found by most sets of positions
_BEYOND = 0.01  # share of further noncentrality that still counts, because some steps need more
_LEAST_GAIN = 1e-6  # gain in noncentrality below which a position shows nothing of the steps


@dataclass(frozen=True)
class SmallestStep:
    """Smallest step of `error` that is found, in `unit`. `size` is None if no size of it is found."""

    error: str
    size: float | None
    unit: str

    @property
    def text(self) -> str:
        """The step in words."""
        return f"{self.error}: not found" if self.size is None else f"{self.size:.1f} {self.unit} ({self.error})"


@dataclass(frozen=True, eq=False)
class _ErrorTest:
    """Test of one error. `weights` (k,) are φ/(1 + φ), `penalty` is Σ ln(1 + φ), and `shifts` (k,) is √φ a for a step a
    of 1 µm or 1 µrad."""

    weights: Array
    penalty: float
    shifts: Array

    @classmethod
    def of(cls, information: Array, step: Array) -> _ErrorTest:
        values, vectors = np.linalg.eigh(information)
        seen = values > _UNSEEN
        values, vectors = values[seen], vectors[:, seen]
        penalty = float(np.log1p(values).sum())
        return cls(values / (1.0 + values), penalty, np.sqrt(values) * (vectors.T @ step))

    def reported(self, evidence: float, size: float = 0.0) -> float:
        """Return the probability that the evidence of this error reaches `evidence` after a step of this size in µm or
        µrad."""
        limit = 2.0 * evidence + self.penalty
        if not self.weights.size:
            return float(limit <= 0.0)
        return QuadraticDistribution(self.weights, size * self.shifts, 0.0).exceeds(limit)


@dataclass(frozen=True, eq=False)
class StepPower:
    """Power of a measurement to find a step of the P unknowns. `information`, shape (P, P), is F."""

    unknowns: Unknowns
    information: Array

    @classmethod
    def of(cls, unknowns: Unknowns, factors: Array, covariance: Array) -> StepPower:
        """Return the power of positions with the information factors `factors` (n, r, P), if the unknowns have this
        `covariance` (P, P) before they are measured."""
        rows = factors.reshape(-1, factors.shape[-1])
        noise = np.eye(len(rows)) + rows @ covariance @ rows.T
        return cls(unknowns, np.asarray(rows.T @ np.linalg.solve(noise, rows)))

    @cached_property
    def _tests(self) -> Mapping[str, _ErrorTest]:
        found = {error: coefficients_of(self.unknowns, error) for error in ERRORS}
        return {
            error: _ErrorTest.of(self.information[np.ix_(columns, columns)], smoothest_step(self.unknowns, error))
            for error, columns in found.items()
            if columns.size
        }

    def false_alarm(self, evidence: float) -> float:
        """Return an upper bound of the probability that any error is reported if none has changed. `evidence` is the
        limit of the evidence, at least 0."""
        return min(sum(test.reported(evidence) for test in self._tests.values()), 1.0)

    def evidence_for(self, false_alarm: float = FALSE_ALARM) -> float:
        """Return the limit of the evidence with which `false_alarm` is the bound of the false alarms; 0 if an evidence
        of 0 already has fewer."""
        if self.false_alarm(0.0) <= false_alarm:
            return 0.0
        return root_between(lambda evidence: self.false_alarm(evidence) - false_alarm, 0.0, _LARGEST_EVIDENCE)

    def finds(self, errors: Sequence[str], size: float, false_alarm: float = FALSE_ALARM, power: float = POWER) -> bool:
        """Return True if a step of each of `errors` by `size` in µm or µrad is found with the probability `power`, if
        the limit of the evidence is that of `evidence_for(false_alarm)`.

        That limit itself, a root of the sum over all errors, is not computed: false alarms become fewer as the limit
        rises, so one evaluation at the largest limit that still finds every step decides.
        """
        if any(self.power(error, size, 0.0) < power for error in errors):
            return False
        limit = min(self._largest_evidence(error, size, power) for error in errors)
        total = 0.0
        for test in self._tests.values():
            total += test.reported(limit)
            if total > false_alarm:
                return False
        return True

    def _largest_evidence(self, error: str, size: float, power: float) -> float:
        """Return the largest limit of the evidence with which a step of `error` by `size` is found with the probability
        `power`. The limit 0 must find it."""
        if self.power(error, size, _LARGEST_EVIDENCE) >= power:
            return _LARGEST_EVIDENCE
        return root_between(lambda evidence: self.power(error, size, evidence) - power, 0.0, _LARGEST_EVIDENCE)

    def power(self, error: str, size: float, evidence: float) -> float:
        """Return the probability with which a step of `error` by `size` in µm or µrad is reported as a step of this
        error, if the limit of the evidence is `evidence`."""
        test = self._tests.get(error)
        return 0.0 if test is None else test.reported(evidence, size)

    def smallest(self, error: str, evidence: float, power: float = POWER) -> SmallestStep:
        """Return the smallest step of `error` that is found with the probability `power`."""
        unit = unit_of(self.unknowns, error)
        largest = 1.0
        while self.power(error, largest, evidence) < power:
            largest *= 2.0
            if largest > _LARGEST:
                return SmallestStep(error, None, unit)
        return SmallestStep(
            error, root_between(lambda size: self.power(error, size, evidence) - power, 0.0, largest), unit
        )

    def smallest_of_each(self, evidence: float, power: float = POWER) -> tuple[SmallestStep, ...]:
        """Return the smallest step of each error that can change."""
        return tuple(self.smallest(error, evidence, power) for error in self._tests)


def smoothest_step(unknowns: Unknowns, error: str) -> Array:
    """Return the step (k,) of the k coefficients of `error` by 1 µm or 1 µrad, in units of their standard deviations:
    a change of the coefficient of the lowest order alone."""
    columns = coefficients_of(unknowns, error)
    first = int(np.argmin([unknowns.model.parameters[i].order for i in columns]))
    parameter = unknowns.model.parameters[columns[first]]
    _, factor = MICRO_UNITS[parameter.unit]
    shape = legendre_values(np.linspace(-1.0, 1.0, _TRAVEL_POINTS), parameter.order)[parameter.order]
    height = 1.0 if error in SQUARENESS else float(np.ptp(shape))
    step = np.zeros(len(columns))
    step[first] = 1.0 / (factor * height * unknowns.scale[columns[first]])
    return step


def unit_of(unknowns: Unknowns, error: str) -> str:
    """Return the unit of a step of `error`: µm or µrad."""
    return next(MICRO_UNITS[one.unit][0] for one in unknowns.model.parameters if one.error == error)


def largest_of(steps: Sequence[SmallestStep]) -> SmallestStep:
    """Return the step that is found worst: one that is not found, or else the largest. All have the same unit."""
    return max(steps, key=lambda one: np.inf if one.size is None else one.size)


def rank_by_power(
    unknowns: Unknowns, factors: Array, covariance: Array, steps: Mapping[str, float], minutes: Array
) -> list[int]:
    """Return the indices of N positions in the order in which they find the given steps fastest, one of each error.

    The next position is always the one that most increases, per minute, the sum of min(λ, λ₁) over the errors. λ is the
    noncentrality of the step with all positions until then, and λ₁ = 30 is about what a step needs to be found, so
    errors that are found already contribute little more: 1 % of what λ still gains. Positions that show nothing of the
    steps are left out.

    `factors` (N, r, P) are the information factors of the positions, `covariance` (P, P) is that of the P `unknowns`,
    `steps` gives the size of each step in µm or µrad by the name of the error, and `minutes` (N,) is the time of each
    position.
    """
    moved = np.zeros((len(steps), unknowns.blocks.size))
    for row, (error, size) in zip(moved, steps.items(), strict=True):
        row[coefficients_of(unknowns, error)] = size * smoothest_step(unknowns, error)
    information, obtained = np.zeros(covariance.shape), np.zeros(len(moved))
    left, order = np.ones(len(factors), dtype=bool), list[int]()
    while left.any():
        # covariance of z after the positions so far, and what each further position would show of the steps
        after = covariance - covariance @ information @ covariance
        moved_then = moved - moved @ information @ covariance
        noise = np.eye(factors.shape[1]) + factors @ after @ factors.transpose(0, 2, 1)
        seen = factors @ moved_then.T
        gain = np.einsum("nre,nre->ne", seen, np.linalg.solve(noise, seen))
        needed = np.minimum(obtained + gain, _ENOUGH).sum(axis=1) - np.minimum(obtained, _ENOUGH).sum()
        value = needed + _BEYOND * gain.sum(axis=1)
        best = int(np.argmax(np.where(left, value / minutes, -np.inf)))
        if gain[best].sum() <= _LEAST_GAIN:
            break
        order.append(best)
        left[best] = False
        chosen = factors[best]
        through = chosen - chosen @ covariance @ information
        information = information + through.T @ np.linalg.solve(noise[best], through)
        obtained = obtained + gain[best]
    return order
