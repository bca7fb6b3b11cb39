"""Random machines for a test of the uncertainties that an identification states.

The error model that is identified cannot fully represent these machines, and the true measurement conditions differ
from the stated conditions.
"""

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

# above the order of the identified models, which is 5 unless a machine file states another
TRUE_ORDER = 7
AS_MODELLED = "as modelled"
"""Form of machines that the model can represent and that are measured under the stated conditions. Such machines are
used to check the uncertainty regions of the parameters."""

_AMPLITUDE = (0.7, 1.3)  # factor on all parameters of a machine, relative to its family
_BEAM_AMPLITUDE = (0.5, 1.5)  # factor on the deflection of the machine file
_NOISE_RATIO = (0.7, 1.5)  # ratio of true to stated touch noise
_TEMPERATURE_C = (17.0, 23.0)
THERMOMETER_UNCERTAINTY_K = 0.1
_DRIFT_MM = 0.5e-3

MakeDeflection = Callable[[Ranges, np.random.Generator], DeflectionGrid]
_DRAW_FUNCTIONS: Mapping[str, MakeDeflection] = {
    "rails": deflection_forms.rail_deflection,
    "smooth": deflection_forms.smooth_random_deflection,
    "portal": deflection_forms.portal_deflection,
    "thermal": deflection_forms.thermal_deflection,
}
DEFLECTION_FORMS = ("none", "beams", *_DRAW_FUNCTIONS)
"""Forms of deflection. The form `beams` is the deflection of the machine file, multiplied by a random amplitude."""


@dataclass(frozen=True, eq=False)
class RandomMachine:
    """Random machine and the true conditions of its measurement.

    `form` is the name of the form of the machine's deflection, or "as modelled" for a machine that the error model
    represents exactly. `truth` contains the true errors of the machine. `assumptions` contains the true temperature of
    the artefact, the uncertainty of the thermometer, the drift, and the other influences to be simulated. `noise` is
    the true standard deviation of the touch noise divided by the stated one.
    """

    form: str
    truth: TrueMachine
    assumptions: TruthAssumptions
    noise: float

    def measure(self, planned: Observations, artefacts: Artefact, rng: np.random.Generator) -> Observations:
        """Simulate the measurement of the `planned` balls on this machine, and return the observations.

        As in a real measurement, the covariance in the observations is the stated covariance of the ball centres, not
        the true one.
        """
        true = replace(planned, covariance=self.noise**2 * planned.covariance)
        seen = simulated_observations(true, artefacts, self.truth, self.assumptions, rng)
        return replace(seen, covariance=planned.covariance)


def draw_random_machine(
    description: MachineDescription, tool_offset: Array, form: str, rng: np.random.Generator
) -> RandomMachine:
    """Draw a random machine with the given `form` of deflection.

    `form` is one of `DEFLECTION_FORMS`, or `AS_MODELLED` for a machine that the error model in `description` represents
    exactly and whose measurement conditions are the stated ones.
    """
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
    return RandomMachine(form, truth, assumptions, float(np.exp(rng.uniform(*np.log(_NOISE_RATIO)))))


def _deflection(description: MachineDescription, form: str, rng: np.random.Generator) -> DeflectionGrid | None:
    if form in _DRAW_FUNCTIONS:
        return _DRAW_FUNCTIONS[form](description.limits, rng)
    grid = description.deflection
    if form == "none" or grid is None:
        return None
    return replace(grid, values=rng.uniform(*_BEAM_AMPLITUDE) * grid.values)
