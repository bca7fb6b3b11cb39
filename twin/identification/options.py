"""Options of an identification."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.instruments.readings import InstrumentReadings, shared_errors
from twin.identification.prior_from_estimate import CarriedOverPrior
from twin.identification.scales import Scales
from twin.thermal.models import ThermalModel

Formulation = Literal["centres", "distances"]
Weights = Literal["full", "unit"]
OutlierPolicy = Literal["reject", "none"]


@dataclass(frozen=True, eq=False)
class Options:
    """Options of an identification. The defaults are those of a production run.

    `formulation` is "centres" for ball centres with free poses, or "distances" for pairwise distances (the published
    method on which this project is based).

    `use_prior` is True if the family is used as a Gaussian prior. If it is False, parameter combinations that the data
    do not determine are held at zero.

    `prior_standard_deviation` (p,) in mm or rad replaces the standard deviations of the family.

    `carried_over` is the posterior of machine, artefact and misfit from an earlier estimate. It replaces the family and
    the certificate.

    `weights` is "full" if the observations are weighted by their covariances. It is "unit" if all coordinates or all
    distances have the same weight; the nuisance unknowns (all unknowns except the parameters and the poses) are then
    omitted.

    `cut_off` is a share of the largest singular value of the unweighted distance equations, with the parameters in
    units of the family. The estimate is zero along every direction whose singular value is smaller, and fits the
    distances with the smallest norm otherwise. If it is None, only directions that the distances do not determine are
    zero. It is meant for studies of published methods, not for the calibration of a machine.

    `estimate_scales` is True if the scales of touch noise, prior and misfit are estimated by maximum marginal
    likelihood. If it is False, all scales are 1.

    `outliers` is "reject" if outliers are found by their studentised residuals and removed before the final fit. It is
    "none" if all rows are accepted.

    `false_alarm` is the probability that at least one ball is rejected from a set without outliers.

    `misfit_mm` is the prior rms over the workspace of the errors that the model cannot represent. A value of 0 switches
    the misfit off. A carried-over estimate keeps its own value.

    `temperature_standard_uncertainty_k` is the standard uncertainty of the artefact's thermometer. The error of the
    thermometer is common to all rows. If it is None, it is that of the carried-over estimate; without such an estimate
    the thermometer is exact. An uncertainty that differs from that of the carried-over estimate means another
    thermometer, whose error is unknown again.

    `drift` is the temperature model that the thermal regressors of the observations belong to. It is None if drift of
    the machine is not estimated. `state_regressors` (w,) contains the thermal regressors in K of the state that the
    estimate describes. If it is None, all regressors of this state are zero, as at the start of the measurement.

    `instruments` are readings of other instruments which are evaluated together with the ball centres. They describe
    the machine without drift. `join_contradicting` is True if those that contradict the ball centres or each other are
    used all the same.
    """

    formulation: Formulation = "centres"
    use_prior: bool = True
    prior_standard_deviation: Array | None = None
    carried_over: CarriedOverPrior | None = None
    weights: Weights = "full"
    estimate_scales: bool = True
    cut_off: float | None = None
    outliers: OutlierPolicy = "reject"
    false_alarm: float = 0.01
    misfit_mm: float = 0.001
    temperature_standard_uncertainty_k: float | None = None
    drift: ThermalModel | None = None
    state_regressors: Array | None = None
    instruments: tuple[InstrumentReadings, ...] = ()
    join_contradicting: bool = False

    @property
    def start_scales(self) -> Scales:
        """Scales with which an estimation of the scales starts. They are those of a carried-over estimate, but 1 for
        the noise; without one, all are 1."""
        return Scales() if self.carried_over is None else replace(self.carried_over.scales, noise=1.0)

    def __post_init__(self) -> None:
        _check_word("formulation", self.formulation, ("centres", "distances"))
        _check_word("weights", self.weights, ("full", "unit"))
        _check_word("outliers", self.outliers, ("reject", "none"))
        if not 0.0 < self.false_alarm < 1.0:
            raise DataError(f"false_alarm must lie between 0 and 1, not {self.false_alarm}")
        if self.cut_off is not None:
            self._check_cut_off(self.cut_off)
        if not self.misfit_mm >= 0.0:
            raise DataError(f"misfit_mm must not be negative, not {self.misfit_mm}")
        thermometer_k = self.temperature_standard_uncertainty_k
        if thermometer_k is not None and not thermometer_k >= 0.0:
            raise DataError("temperature_standard_uncertainty_k must not be negative")
        if self.carried_over is not None:
            self._check_carried()
        if self.instruments and (not self.use_prior or self.weights != "full"):
            raise DataError(
                "readings of instruments are joined by their covariances",
                hint="switch the prior on and use full weights, or omit the instruments",
            )
        shared_errors(self.instruments)  # refuses a device of two kinds
        if self.carried_over is not None:
            for one in self.instruments:
                if one.checksum in self.carried_over.joined_readings:
                    raise DataError(
                        f"the readings of {one.name} are already part of the earlier estimate",
                        hint="give an instrument again only if it has taken new readings",
                    )

    def _check_cut_off(self, cut_off: float) -> None:
        if not 0.0 < cut_off < 1.0:
            raise DataError(f"cut_off must lie between 0 and 1, not {cut_off}")
        if self.formulation != "distances" or self.weights != "unit" or self.use_prior:
            raise DataError(
                "a cut-off of singular values needs distances with unit weights and no prior",
                hint="omit the cut-off, or use formulation='distances', weights='unit' and use_prior=False",
            )

    def _check_carried(self) -> None:
        """Check that the options agree with the carried-over estimate, which already includes every prior and the units
        of every prior."""
        if not self.use_prior or self.weights != "full":
            hint = "switch the prior on and use full weights, or omit the earlier estimate"
            raise DataError("carrying over an estimate requires the prior and full weights", hint=hint)
        if self.prior_standard_deviation is not None:
            raise DataError("give either prior standard deviations or a carried-over estimate, not both")


def _check_word(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise DataError(f"unknown {name} '{value}'", hint=f"Known: {', '.join(known)}")
