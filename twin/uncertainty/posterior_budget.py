"""Budget of uncertainty of one estimate: the part of its covariance that each influence causes.

The covariance C of all unknowns of an identification, given the measurements, is divided into parts that add up to it.
The error of the artefact's temperature, that of its coefficient of thermal expansion (CTE), those of its certificate
and that of its sag are unknowns themselves. If an influence with the unknowns b were known, C would decrease by C[:,
b] C[b, b]⁻¹ C[b, :]. This is its part; each is taken from what the influences before it have left.

The rest S is the covariance of the parameters and of the misfit. In the directions u in which S and the prior
covariance P of the machine's family are both diagonal, with S = Σ λ u u' and P = Σ u u', a share 1 - λ of the
knowledge comes from the measurements and a share λ from the family. With fixed scales, Σ λ (1 - λ) u u' = H⁻¹ N H⁻¹ is
exactly the covariance that the noise of the ball centres causes, where H = S⁻¹ and N is the information of the
measurements, and Σ λ² u u' = H⁻¹ P⁻¹ H⁻¹ is the one that errors of the machine cause which the measurements do not
determine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import eigh

from twin.arrays import Array
from twin.identification.estimate import Misfit
from twin.identification.normal import PriorPrecision
from twin.identification.predicted import unresolved_variance
from twin.identification.scales import Scales
from twin.identification.series_prior import SeriesPrior
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel

TEMPERATURE, EXPANSION, CERTIFICATE, SAG = "temperature", "expansion", "certificate", "sag"
CENTRES, UNDETERMINED, CENTRES_AND_PRIOR = "centres", "undetermined", "centres and prior"
FORM, SHORT_WAVES = "form", "short waves"
INFLUENCES = (CENTRES, CENTRES_AND_PRIOR, CERTIFICATE, TEMPERATURE, EXPANSION, SAG, UNDETERMINED, FORM, SHORT_WAVES)
"""Influences in the order of the table.

`centres` is the noise of the ball centres, and `undetermined` the errors of the machine that the positions do not
determine. If the prior is not the machine's family, they cannot be told apart: `centres and prior` is both. `form` are
the estimated errors that the parameters, and so the table, cannot represent. `short waves` are the errors whose
wavelength is too short for the misfit modes.
"""


class KnownEstimate(Protocol):
    """Estimate, computed or stored, with the covariance of all its unknowns."""

    @property
    def model(self) -> ErrorModel: ...
    @property
    def unknowns(self) -> Unknowns: ...
    @property
    def z_covariance(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def misfit(self) -> Misfit | None: ...
    @property
    def scales(self) -> Scales: ...


@dataclass(frozen=True, eq=False)
class PosteriorBudget:
    """Parts of the covariance of the p parameters, in mm or rad, and the q misfit coefficients of an estimate.

    `parts` contains the covariance (p + q, p + q) that each influence causes; they add up to that of the estimate.
    `expected` (p + q,) are the expected misfit coefficients after p zeros, and `unresolved_mm2` is the variance per
    direction of the short waves.
    """

    parts: Mapping[str, Array]
    expected: Array
    unresolved_mm2: float

    def standard_uncertainties(self, gradient: Array) -> dict[str, float]:
        """Return the standard uncertainty of a quantity that each influence causes. `gradient` (p + q,) contains the
        derivatives of the quantity; the result has its unit. The squares add up."""
        return {name: _root(float(gradient @ part @ gradient)) for name, part in self.parts.items()}

    def remaining_rms(self, form: Array) -> dict[str, float]:
        """Return the part of the volumetric compensated error that each influence causes, in mm. `form` (p + q, p + q)
        is the quadratic form of the error field. The squares add up to that of the predicted error."""
        squares = {name: float(np.vdot(form, part)) for name, part in self.parts.items()}
        squares[FORM] = float(self.expected @ form @ self.expected)
        squares[SHORT_WAVES] = 3.0 * self.unresolved_mm2
        return {name: _root(square) for name, square in squares.items()}


def posterior_budget(estimate: KnownEstimate, *, family_prior: bool) -> PosteriorBudget:
    """Return the budget of uncertainty of an estimate.

    `family_prior` is True if the prior of the parameters was the machine's family with estimated scales; otherwise the
    noise of the ball centres is not told apart from what the prior leaves.
    """
    unknowns, blocks, misfit = estimate.unknowns, estimate.unknowns.blocks, estimate.misfit
    size = blocks.size
    own = [*range(size)[blocks.parameters], *(() if misfit is None else range(size)[blocks.misfit])]
    influences = _influences(unknowns)
    left = np.asarray(estimate.z_covariance, dtype=np.float64)
    parts: dict[str, Array] = {}
    for name, columns in influences.items():
        known = left[:, columns] @ np.linalg.pinv(left[np.ix_(columns, columns)], hermitian=True) @ left[columns]
        parts[name] = known[np.ix_(own, own)]
        left = left - known
    rest = left[np.ix_(own, own)]
    parts |= _shared(rest, _family_precision(estimate)[np.ix_(own, own)]) if family_prior else {CENTRES_AND_PRIOR: rest}
    scale = np.concatenate((unknowns.scale, np.ones(len(own) - len(unknowns.scale))))
    expected = np.zeros(len(own))
    if misfit is not None:
        expected[len(unknowns.scale) :] = misfit.coefficients
    physical = {name: parts[name] * np.multiply.outer(scale, scale) for name in INFLUENCES if name in parts}
    return PosteriorBudget(physical, expected, unresolved_variance(estimate))


def _influences(unknowns: Unknowns) -> dict[str, list[int]]:
    """Return the indices of the unknowns of each influence on the artefact, in the order in which they are removed."""
    blocks = unknowns.blocks
    strains = {name: [blocks.strain.start + i] for i, name in enumerate(unknowns.artefact.strain_names)}
    found = {
        TEMPERATURE: strains.get("thermometer", []),
        EXPANSION: strains.get("cte", []),
        CERTIFICATE: list(range(blocks.size)[blocks.certificate]),
        SAG: list(range(blocks.size)[blocks.sag]),
    }
    return {name: columns for name, columns in found.items() if columns}


def _family_precision(estimate: KnownEstimate) -> Array:
    """Return the prior precision (P, P) of all unknowns that the family and the estimated scales give."""
    unknowns = estimate.unknowns
    series = SeriesPrior.of(unknowns.model, unknowns.scale)
    return PriorPrecision(unknowns.blocks, None, series).matrix(estimate.scales)


def _shared(rest: Array, precision: Array) -> dict[str, Array]:
    """Return the parts of the covariance `rest` that are due to the measurements and to the family, whose prior has the
    matrix `precision`."""
    prior = np.linalg.inv(precision)
    shares, directions = eigh(0.5 * (rest + rest.T), 0.5 * (prior + prior.T))
    columns = prior @ directions
    shares = np.maximum(shares, 0.0)
    # averaged over several scales, a covariance may exceed that of the prior with the likeliest ones
    from_family = np.minimum(shares, 1.0)
    return {
        CENTRES: (columns * (shares * (1.0 - from_family))) @ columns.T,
        UNDETERMINED: (columns * (shares * from_family)) @ columns.T,
    }


def _root(square: float) -> float:
    return float(np.sqrt(max(square, 0.0)))
