"""Result of an identification: the estimated parameters with their covariance and all other estimated quantities."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.artefact.artefact_calibration import ArtefactCalibration
from twin.display import Displayed
from twin.identification.alternatives import Alternative
from twin.identification.checks.certificate_check import BallCheck, check_certificate
from twin.identification.checks.common_scale import CommonScale
from twin.identification.checks.shift_pattern import SAG, EstimatedShift, PatternTest
from twin.identification.checks.step_in_run import StepInRun
from twin.identification.drift_trend import DriftTrend
from twin.identification.evidence import OrderEvidence, scales_at_bounds
from twin.identification.instruments.check_result import InstrumentCheck
from twin.identification.misfit import MisfitModes
from twin.identification.observability import NullDirection, Observability, observability, summary
from twin.identification.options import Formulation
from twin.identification.prior_from_estimate import CarriedOverPrior, DriftFactor
from twin.identification.scales import Scales
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel
from twin.thermal.machine_drift import DriftEstimate
from twin.units import MM_PER_UM


@dataclass(frozen=True, eq=False)
class Misfit:
    """Estimated misfit: error fields that the error model cannot represent.

    `coefficients` (q,) contains the coefficients of the q fields `modes`, and `covariance` (q, q) is their covariance.
    `cross_covariance` (p, q) is the covariance of the p parameters of the error model with the coefficients. The misfit
    field in mm is the sum of all modes, each multiplied by its coefficient and by `amplitude_mm`. `unresolved_mm2` is
    the variance per direction, in mm², of the part of the misfit whose wavelength is too short for the modes.
    """

    modes: MisfitModes
    amplitude_mm: float
    coefficients: Array
    covariance: Array
    cross_covariance: Array
    unresolved_mm2: float = 0.0

    @classmethod
    def of(cls, unknowns: Unknowns, z: Array, z_covariance: Array, unresolved_mm2: float) -> Misfit | None:
        """Return the misfit that the values `z` (P,) of all `unknowns` and their covariance (P, P) contain; None if it
        was not estimated."""
        if unknowns.modes is None:
            return None
        own, misfit = unknowns.blocks.parameters, unknowns.blocks.misfit
        return cls(
            modes=unknowns.modes,
            amplitude_mm=unknowns.misfit_mm,
            coefficients=z[misfit],
            covariance=z_covariance[misfit, misfit],
            cross_covariance=unknowns.scale[:, None] * z_covariance[own, misfit],
            unresolved_mm2=unresolved_mm2,
        )

    def field(self, axis_positions: Array) -> Array:
        """Return the expected misfit (n, 3) in mm at axis positions (n, 3)."""
        return np.asarray(self.amplitude_mm * (self.modes.at(axis_positions) @ self.coefficients))


@dataclass(frozen=True, eq=False)
class Estimate(Displayed):
    """Estimated parameters (p,) of the error model used for compensation, in mm or rad, with their covariance (p, p).

    The covariance includes the uncertainty due to the artefact's poses and certificate, thermal strain, misfit and
    drift. `residuals_mm` (n, 3) contains the residuals of all n rows (measured ball centres), including rejected rows,
    in the order of the observations. `chi2_normalised` is the sum of squared residuals in units of the stated noise,
    divided by the degrees of freedom. `rejected` contains the position, the ball and the tool of each rejected row.
    `scales` are the estimated scales of noise, prior and misfit.

    `misfit` contains the errors that the model cannot represent; it is None if they were not estimated. `information`
    (p, p) is the information matrix of the measurements alone, for parameters in units of `prior_scale`. `z` (P,) and
    `z_covariance` (P, P) are the values and the covariance of all P `unknowns` together, in units of their prior
    standard deviations. `alternatives` contains results of equal weight for other scales that the measurements allow.
    `order_evidence` contains the evidence (marginal likelihood) of each Legendre order that was compared; it is empty
    if the order was given. `drift` is the drift of the machine during the measurement, or None if drift was not
    estimated. `drift_factor` is the factor on the process noise between nights that was learned until this estimate,
    and `trend` is the knowledge about errors that drift in one direction. `free_balls` contains the balls whose
    certified centres contradict the measurements; the estimate does not use these centres. `step` is the result of the
    test for a sudden change of the machine during the measurement; it is None if the measurements were used unchecked.
    `pattern` is the result of the test for shifts that follow a pattern over all positions; None likewise.
    `shifts` are the shifts of the balls, such as lost motion of an axis, that were estimated with the errors of the
    machine because the measurements show them. `common_scale` is the result of the test of the scale that all axes have
    in common; None likewise, or if an estimate was carried over. `instruments` contains the result of the test of each
    other instrument, and whether its readings are part of the estimate. `joined_readings` are the checksums of all
    readings of other instruments in this estimate and in those that it was carried over from.
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
    drift_factor: DriftFactor = field(default_factory=DriftFactor)
    trend: DriftTrend = field(default_factory=DriftTrend, repr=False)
    free_balls: tuple[int, ...] = ()
    step: StepInRun | None = None
    pattern: PatternTest | None = None
    shifts: tuple[EstimatedShift, ...] = ()
    common_scale: CommonScale | None = None
    instruments: tuple[InstrumentCheck, ...] = ()
    joined_readings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<Estimate: {len(self.parameters)} parameters from {len(self.residuals_mm)} balls, "
            f"{len(self.rejected)} rejected, normalised χ² {self.chi2_normalised:.2f}>"
        )

    def carried_over(self, process_noise: ArrayLike | None = None, nights: float = 1.0) -> CarriedOverPrior:
        """Return this estimate as the prior of an estimate made `nights` nights later.

        `process_noise` (p,) contains the standard deviation, in mm or rad, of the change of each parameter per night.
        If it is None, the machine is assumed not to change.
        """
        known = CarriedOverPrior(
            self.unknowns,
            self.z,
            self.z_covariance,
            self.scales,
            self.drift_factor,
            self.degrees_of_freedom,
            self.trend,
            self.joined_readings,
        )
        return known if process_noise is None else known.after(process_noise, nights)

    @property
    def scatter_mm2(self) -> float:
        """Variance in mm² per direction by which the ball centres scatter beyond their stated noise."""
        return self.unknowns.scatter_mm2(self.scales)

    @cached_property
    def certificate_check(self) -> tuple[BallCheck, ...]:
        """Comparison of each certified ball centre with the measurements; empty if the certificate states no
        uncertainty."""
        return check_certificate(self.unknowns, self.z, self.z_covariance, self.free_balls)

    @cached_property
    def artefact_calibration(self) -> ArtefactCalibration | None:
        """Ball centres of the artefact as estimated from the measurements; None if they were not estimated."""
        return self.unknowns.artefact_calibration(self.z, self.z_covariance)

    @property
    def found_sag_mm(self) -> float:
        """Distance in mm by which the ends of a bar were found to hang lower than stated; 0 if it was not estimated."""
        return sum(MM_PER_UM * shift.size_um for shift in self.shifts if shift.name == SAG)

    @property
    def prior_scale(self) -> Array:
        """Units (p,) of the parameters in mm or rad: their prior standard deviations."""
        return self.unknowns.scale

    @property
    def scales_at_bounds(self) -> tuple[str, ...]:
        """Descriptions of the scales that reached a bound of their allowed range. If a scale is at a bound, the
        uncertainties that depend on it are only a guess."""
        return scales_at_bounds(self.scales)

    @property
    def standard_uncertainty(self) -> Array:
        """Standard uncertainty (p,) of each parameter in mm or rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def rank(self) -> int:
        """Number of independent parameter combinations that the measurements alone determine."""
        return self._seen.rank

    @property
    def null_directions(self) -> tuple[NullDirection, ...]:
        """Directions in parameter space that the measurements do not determine. Their number is `model.size`, the
        number of parameters, minus `rank`."""
        return self._seen.null_directions

    @property
    def conditioning(self) -> float:
        """Ratio of the largest to the smallest singular value of the measurement equations in the directions that the
        measurements determine. Parameters are in units of their prior standard deviations."""
        return self._seen.conditioning

    @property
    def null_summary(self) -> tuple[str, ...]:
        """Description of the null directions, with one line for each kind of null direction."""
        return summary(self.null_directions)

    @cached_property
    def _seen(self) -> Observability:
        return observability(self.model, self.information, self.prior_scale, self.tool_offsets)
