"""Result of an identification."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.identification.alternatives import Alternative
from twin.identification.drift import DriftEstimate
from twin.identification.evidence import OrderEvidence, scales_at_bounds
from twin.identification.misfit import MisfitModes
from twin.identification.normal import Scales
from twin.identification.observability import NullDirection, Observability, observability, summary
from twin.identification.options import Formulation
from twin.identification.prior_from_estimate import CarriedOverPrior
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel


@dataclass(frozen=True, eq=False)
class Misfit:
    """Estimated fields that the model cannot represent.

    `coefficients` (q,) of the modes, their `covariance` (q, q) and `cross_covariance` (p, q) with the parameters; a
    field in mm is `amplitude_mm` · modes · coefficients. `unresolved_mm2`: variance per direction of the part of the
    misfit whose wavelength is too short for the modes.
    """

    modes: MisfitModes
    amplitude_mm: float
    coefficients: Array
    covariance: Array
    cross_covariance: Array
    unresolved_mm2: float = 0.0

    def field(self, axis_positions: Array) -> Array:
        """Return the expected misfit (n, 3) in mm at axis positions (n, 3)."""
        return np.asarray(self.amplitude_mm * (self.modes.at(axis_positions) @ self.coefficients))


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters (p,) in mm or rad of the compensation model with their covariance (p, p).

    The covariance is marginal over poses, certificate, thermal strain and misfit. `residuals_mm` (n, 3): residuals of
    all rows, including rejected ones, in the order of the observations. `chi2_normalised`: sum of squared residuals in
    units of the stated noise, divided by the degrees of freedom. `rejected`: (position, ball, tool) of each rejected
    row. `scales`: estimated scales of noise, prior and misfit. `misfit`: None if the misfit was switched off.
    `information` (p, p): information matrix of the measurements alone, with parameters in units of `prior_scale`. `z`
    (P,) and `z_covariance` (P, P): values and covariance of all `unknowns` together. `alternatives`: equally weighted
    results for other scales that the measurements allow. `order_evidence`: evidence of each Legendre order; empty if
    the order was given. `drift`: drift of the machine during the measurement, None if it was not estimated; all other
    results are marginal over the drift.
    """

    model: ErrorModel
    formulation: Formulation
    parameters: Array
    covariance: Array
    residuals_mm: Array
    chi2_normalised: float
    degrees_of_freedom: float
    rejected: tuple[tuple[int, int, int], ...]
    scales: Scales
    tool_offsets: Array
    misfit: Misfit | None = field(repr=False)
    information: Array = field(repr=False)
    unknowns: Unknowns = field(repr=False)
    z: Array = field(repr=False)
    z_covariance: Array = field(repr=False)
    alternatives: tuple[Alternative, ...] = field(default=(), repr=False)
    order_evidence: tuple[OrderEvidence, ...] = ()
    drift: DriftEstimate | None = field(default=None, repr=False)

    def carried_over(self, process_noise: ArrayLike | None = None, nights: float = 1.0) -> CarriedOverPrior:
        """Return this estimate as the prior of an estimate made `nights` nights later.

        `process_noise` (p,): standard deviations (mm or rad) by which each parameter may have changed per night.
        """
        known = CarriedOverPrior(self.unknowns, self.z, self.z_covariance, self.scales)
        return known if process_noise is None else known.after(process_noise, nights)

    @property
    def prior_scale(self) -> Array:
        """Unit of each parameter (p,) in mm or rad: its prior standard deviation."""
        return self.unknowns.scale

    @property
    def scales_at_bounds(self) -> tuple[str, ...]:
        """Descriptions of the scales that reached a bound; the uncertainty that depends on them is a guess."""
        return scales_at_bounds(self.scales)

    @property
    def standard_uncertainty(self) -> Array:
        """Standard uncertainty (p,) of each parameter."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def rank(self) -> int:
        """Number of independent parameter combinations that the measurements alone determine."""
        return self._seen.rank

    @property
    def null_directions(self) -> tuple[NullDirection, ...]:
        """Parameter directions that the measurements leave undetermined; their number is `model.size` - `rank`."""
        return self._seen.null_directions

    @property
    def conditioning(self) -> float:
        """Ratio of the largest to the smallest singular value of the determined part, with parameters in units of their
        prior standard deviation."""
        return self._seen.conditioning

    @property
    def null_summary(self) -> tuple[str, ...]:
        """One line for each kind of null direction."""
        return summary(self.null_directions)

    @cached_property
    def _seen(self) -> Observability:
        return observability(self.model, self.information, self.prior_scale, self.tool_offsets)
