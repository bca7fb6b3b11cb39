"""Sudden change (jump) of one geometric error of the machine, as a hypothesis that is tested against no change.

Let the P unknowns z of an identification have the score s, shape (P,), and the information F, shape (P, P), for a
change. The matrix J selects the coefficients of one error in z. The hypothesis is that these coefficients have changed
by a vector a with mean zero and covariance Λ, which is the covariance of the coefficients in the family of machines.
The logarithm of the likelihood ratio of this hypothesis against no change is

    ½ sᵀJ (Λ⁻¹ + JᵀF J)⁻¹ Jᵀs - ½ ln det(1 + Λ JᵀF J),

and the expected change is a = (Λ⁻¹ + JᵀF J)⁻¹ Jᵀs. The second term penalises an error with many coefficients for its
degrees of freedom (Kass & Raftery, J. Am. Stat. Assoc. 90, 1995).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ERROR_MOTIONS, SQUARENESS
from twin.machine.legendre import legendre_values
from twin.units import MICRO_UNITS

ERRORS = (*ERROR_MOTIONS, *SQUARENESS)
"""The 21 geometric errors of three linear axes, ISO 230-1."""

# gives the peak-to-valley value of a series of order 5 to within 0.3 %, of order 10 to within 2 % (random series)
_TRAVEL_POINTS = 101

Columns = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True)
class SuspectedJump:
    """Geometric error that may have jumped; `error` is its ISO 230-1 name.

    `evidence` is the natural logarithm of the likelihood ratio of a jump against no jump. `chi2` is the test statistic
    of the jump, with `freedom` degrees of freedom.

    `change` is the size of the jump in `unit`. For a squareness it is the change of the angle. For an error motion it
    is the peak-to-valley value of the change over the travel of the axis; it is negative if the change at the end of
    the travel is smaller than the change at the start. `coefficients` gives the change of each coefficient, keyed by
    its name, in mm or rad.
    """

    error: str
    evidence: float
    chi2: float
    freedom: int
    change: float
    unit: str
    coefficients: Mapping[str, float]

    @property
    def text(self) -> str:
        return f"{self.error} changed by {self.change:+.1f} {self.unit}"


def coefficients_of(unknowns: Unknowns, error: str) -> Columns:
    """Return the indices of the coefficients of `error` among the unknowns. Coefficients that are zero in the whole
    family of machines are left out; the result is empty if none remains."""
    model, scale = unknowns.model, unknowns.scale
    return np.array([i for i, one in enumerate(model.parameters) if one.error == error and scale[i] > 0.0], int)


@dataclass(frozen=True, eq=False)
class ErrorCoefficients:
    """Coefficients of the E errors that can jump, as indices `columns` (E, m) of the unknowns. An error with fewer than
    m coefficients repeats its last one, and `present` (E, m) is 0 there and 1 elsewhere."""

    errors: tuple[str, ...]
    columns: Columns
    present: Array

    @classmethod
    def of(cls, unknowns: Unknowns) -> ErrorCoefficients:
        found = {error: coefficients_of(unknowns, error) for error in ERRORS}
        found = {error: columns for error, columns in found.items() if columns.size}
        size = max(len(columns) for columns in found.values())
        padded = [np.pad(columns, (0, size - len(columns)), mode="edge") for columns in found.values()]
        present = [np.arange(size) < len(columns) for columns in found.values()]
        return cls(tuple(found), np.stack(padded), np.stack(present).astype(np.float64))

    def of_error(self, number: int) -> Columns:
        """Return the indices (k,) of the coefficients of the error with this number."""
        return np.asarray(self.columns[number][self.present[number] > 0.0])


def jump_evidence(score: Array, information: Array, jump: float = 1.0) -> tuple[Array, Array]:
    """Return the natural logarithm (...) of the likelihood ratio of a jump against no jump, and the expected change
    (..., m) of the m coefficients in units of their standard deviations in the family.

    `score` (..., m) and `information` (..., m, m) refer to these coefficients; the leading dimensions count hypotheses.
    `jump` is the standard deviation of the assumed jump of a coefficient, divided by the standard deviation of the
    coefficient in the family of machines.
    """
    size = score.shape[-1]
    # Λ = jump²: det(1 + Λ F) = det(Λ⁻¹ + F) Λ^m
    precision = information + np.eye(size) / jump**2
    change = np.linalg.solve(precision, score[..., None])[..., 0]
    determinant = np.linalg.slogdet(precision)[1] + 2.0 * size * math.log(jump)
    evidence: Array = 0.5 * (np.einsum("...i,...i->...", score, change) - determinant)
    return evidence, np.asarray(change)


def log_mean_ratio(evidence: Array) -> float:
    """Return the natural logarithm of the mean likelihood ratio of hypotheses that are equally likely beforehand.
    `evidence` (...) contains the logarithms of their ratios."""
    largest = float(evidence.max())
    return largest + math.log(float(np.mean(np.exp(evidence - largest))))


def largest_false_alarm(log_ratio: float) -> float:
    """Return the largest probability with which `log_mean_ratio` reaches `log_ratio` if no hypothesis is true (Markov:
    the mean ratio then has the expected value 1)."""
    return math.exp(-max(log_ratio, 0.0))


def suspected_jump(unknowns: Unknowns, error: str, score: Array, information: Array, jump: float) -> SuspectedJump:
    """Return the suspected jump of `error`. `score` (m,) and `information` (m, m) refer to the m coefficients that
    `coefficients_of` names; `jump` is that of `jump_evidence`."""
    columns = coefficients_of(unknowns, error)
    evidence, step = jump_evidence(score, information, jump)
    # χ² without the prior Λ on the size of the jump: sᵀF⁻¹s; a coefficient that was not measured adds nothing
    sharp = float(score @ np.linalg.lstsq(information, score, rcond=1e-12)[0])
    change, unit = _size(unknowns, error, columns, step)
    names = [unknowns.model.names[i] for i in columns]
    values = (unknowns.scale[columns] * step).tolist()
    return SuspectedJump(
        error, float(evidence), sharp, len(columns), change, unit, dict(zip(names, values, strict=True))
    )


def _size(unknowns: Unknowns, error: str, columns: Columns, step: Array) -> tuple[float, str]:
    parameters = [unknowns.model.parameters[i] for i in columns]
    values = unknowns.scale[columns] * step
    unit, factor = MICRO_UNITS[parameters[0].unit]
    if error in SQUARENESS:
        return factor * float(values[0]), unit
    orders = [one.order for one in parameters]
    along = values @ legendre_values(np.linspace(-1.0, 1.0, _TRAVEL_POINTS), max(orders))[orders]
    return factor * float(np.ptp(along)) * (1.0 if along[-1] >= along[0] else -1.0), unit
