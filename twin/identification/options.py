"""Options of an identification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.drift import DriftPrior
from twin.identification.prior_from_estimate import CarriedOverPrior

Formulation = Literal["centres", "distances"]
Weights = Literal["full", "unit"]
OutlierPolicy = Literal["reject", "none"]


@dataclass(frozen=True, eq=False)
class Options:
    """Options of an identification; the defaults are those of a production run.

    `formulation`: ball centres with free poses, or pairwise distances (the published method).

    `use_prior`: use the family as Gaussian prior; otherwise directions that the data leave open are held at zero.

    `prior_standard_deviation` (p,) in mm or rad: replaces the standard deviations of the family.

    `carried_over`: posterior of machine, artefact and misfit from an earlier estimate, replacing family and
    certificate.

    `weights`: "full" weights the observations by their covariances; "unit" gives all coordinates or distances the same
    weight and omits the nuisance unknowns.

    `estimate_scales`: estimate the scales of touch noise, prior and misfit by maximum marginal likelihood; otherwise
    all are 1.

    `outliers`: "reject" removes outliers by their studentised residuals and fits again; "none" accepts all rows.

    `false_alarm`: probability that any ball is rejected from a set without outliers.

    `misfit_mm`: prior rms over the workspace of the errors that the model cannot represent; 0 switches the misfit off.
    A carried-over estimate keeps its own value.

    `temperature_standard_uncertainty_k`: standard uncertainty of the artefact's thermometer, whose error is common to
    all rows.

    `drift`: prior of a drift along the thermal regressors of the observations; None if drift is not estimated.
    `state_regressors` (w,) in K: thermal regressors of the state that the estimate describes; None for all zero.
    """

    formulation: Formulation = "centres"
    use_prior: bool = True
    prior_standard_deviation: Array | None = None
    carried_over: CarriedOverPrior | None = None
    weights: Weights = "full"
    estimate_scales: bool = True
    outliers: OutlierPolicy = "reject"
    false_alarm: float = 0.01
    misfit_mm: float = 0.001
    temperature_standard_uncertainty_k: float = 0.0
    drift: DriftPrior | None = None
    state_regressors: Array | None = None

    def __post_init__(self) -> None:
        _check_word("formulation", self.formulation, ("centres", "distances"))
        _check_word("weights", self.weights, ("full", "unit"))
        _check_word("outliers", self.outliers, ("reject", "none"))
        if not 0.0 < self.false_alarm < 1.0:
            raise DataError(f"false_alarm must lie between 0 and 1, not {self.false_alarm}")
        if not self.misfit_mm >= 0.0:
            raise DataError(f"misfit_mm must not be negative, not {self.misfit_mm}")
        if not self.temperature_standard_uncertainty_k >= 0.0:
            raise DataError("temperature_standard_uncertainty_k must not be negative")
        if self.carried_over is not None:
            self._check_carried()

    def _check_carried(self) -> None:
        """Check that options agree with a carried-over estimate, which already includes every prior and its units."""
        if not self.use_prior or self.weights != "full":
            hint = "switch the prior on and use full weights, or omit the earlier estimate"
            raise DataError("carrying over an estimate requires the prior and full weights", hint=hint)
        if self.prior_standard_deviation is not None:
            raise DataError("give either prior standard deviations or a carried-over estimate, not both")


def _check_word(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise DataError(f"unknown {name} '{value}'", hint=f"Known: {', '.join(known)}")
