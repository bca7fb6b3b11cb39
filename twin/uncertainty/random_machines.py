"""Machines of another making than the model that is identified, on a day that is not quite as stated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.machine import deflection_forms
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import Ranges
from twin.machine.machine_description import MachineDescription
from twin.machine.true_machine import TrueMachine
from twin.uncertainty.monte_carlo import simulated_observations
from twin.uncertainty.truth_assumptions import TruthAssumptions

TRUE_ORDER = 7
AS_MODELLED = "as modelled"
"""Of the family itself, nothing beside it and everything as stated: the check that regions of parameters hold."""

_AMPLITUDE = (0.7, 1.3)  # of all parameters of a machine, against its family
_BEAMS = (0.5, 1.5)  # of the deflection of the machine file
_NOISE = (0.7, 1.5)  # true over stated touch noise
_TEMPERATURE_C = (17.0, 23.0)
THERMOMETER_UNCERTAINTY_K = 0.1
_DRIFT_MM = 0.5e-3

MakeDeflection = Callable[[Ranges, np.random.Generator], DeflectionGrid]
_DRAWN: Mapping[str, MakeDeflection] = {
    "rails": deflection_forms.rail_deflection,
    "smooth": deflection_forms.smooth_random_deflection,
    "portal": deflection_forms.portal_deflection,
    "thermal": deflection_forms.thermal_deflection,
}
DEFLECTION_FORMS = ("none", "beams", *_DRAWN)
"""Of deflection; `beams` is that of the machine file, drawn in size."""


@dataclass(frozen=True, eq=False)
class RandomMachine:
    """A machine and the day on which it is measured; `noise`: true over stated touch noise."""

    form: str
    truth: TrueMachine
    assumptions: TruthAssumptions
    noise: float

    def measured(self, planned: Observations, artefacts: Artefact, rng: np.random.Generator) -> Observations:
        """What it would measure of `planned`, with the covariance that is stated, not the true one."""
        true = replace(planned, covariance=self.noise**2 * planned.covariance)
        seen = simulated_observations(true, artefacts, self.truth, self.assumptions, rng)
        return replace(seen, covariance=planned.covariance)


def draw_random_machine(
    description: MachineDescription, tool_offset: Array, form: str, rng: np.random.Generator
) -> RandomMachine:
    """Draw a machine with a deflection of one of `DEFLECTION_FORMS`, or one that is as modelled."""
    if form == AS_MODELLED:
        assumptions = TruthAssumptions.as_modelled(description)
        parameters = description.family.prior_standard_deviation * rng.standard_normal(description.model.size)
        return RandomMachine(form, TrueMachine(description.model, parameters, tool_offset, None), assumptions, 1.0)
    richer = description.with_order(TRUE_ORDER)
    parameters = rng.uniform(*_AMPLITUDE) * richer.family.draw(rng, 1)[0]
    truth = TrueMachine(richer.model, parameters, tool_offset, _deflection(description, form, rng))
    assumptions = TruthAssumptions(
        richer.family,
        truth.deflection,
        artefact_temperature_c=rng.uniform(*_TEMPERATURE_C),
        thermometer_uncertainty_k=THERMOMETER_UNCERTAINTY_K,
        drift_mm=_DRIFT_MM,
    )
    return RandomMachine(form, truth, assumptions, float(np.exp(rng.uniform(*np.log(_NOISE)))))


def _deflection(description: MachineDescription, form: str, rng: np.random.Generator) -> DeflectionGrid | None:
    if form in _DRAWN:
        return _DRAWN[form](description.limits, rng)
    grid = description.deflection
    if form == "none" or grid is None:
        return None
    return replace(grid, values=rng.uniform(*_BEAMS) * grid.values)
