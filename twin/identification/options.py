"""How an identification is to be done."""

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
    """Choices of an identification; the defaults are those of a production run.

    `formulation`: ball centres with free poses, or pairwise distances (the published method).
    `use_prior`: the family as Gaussian prior; off, directions that the data leave open stay zero.
    `prior_standard_deviation` (p,) mm or rad instead of the family's.
    `carried_over`: what an earlier estimate knows of machine, artefact and misfit, instead of family and certificate.
    `weights`: the observations' covariances, or all coordinates or distances alike (then without nuisance blocks).
    `estimate_scales`: scales of touch noise, prior and misfit by maximum marginal likelihood; off, all are 1.
    `outliers`: reject and refit by studentised residuals, or keep all.
    `false_alarm`: chance that a set without outliers loses a ball.
    `misfit_mm`: prior rms, over the workspace, of what the model cannot represent; 0 switches it off. What is carried
    over keeps its own.
    `temperature_standard_uncertainty_k`: of the artefact's thermometer, common to all rows.
    `drift`: prior of a drift along the thermal regressors of the observations; None if the machine does not drift.
    `state_regressors` (w,) K: thermal regressors of the state that the estimate describes; None for all zero.
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
        """What is carried over is a prior of everything, and has its units already."""
        if not self.use_prior or self.weights != "full":
            hint = "switch the prior on and take full weights, or start without the earlier estimate"
            raise DataError("an estimate can only be carried over with prior and full weights", hint=hint)
        if self.prior_standard_deviation is not None:
            raise DataError("give either prior standard deviations or an estimate carried over, not both")


def _check_word(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise DataError(f"unknown {name} '{value}'", hint=f"Known: {', '.join(known)}")
