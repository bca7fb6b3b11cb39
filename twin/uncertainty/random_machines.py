"""Random machines for a test of the uncertainties that an identification states.

The error model that is identified cannot fully represent these machines, and the true measurement conditions differ
from the stated conditions.

In an identification, the misfit model consists of products of Legendre polynomials. The deflection fields of this
module are not products of Legendre polynomials: they consist of bending lines of beams, sines of any pitch,
exponentials and random waves, and no Legendre series of one axis can represent them either. A coverage probability
(fraction of machines whose true error lies in the stated region) found with them is therefore a meaningful test of the
misfit model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import Ranges
from twin.machine.machine_description import MachineDescription
from twin.machine.true_machine import TrueMachine
from twin.uncertainty.monte_carlo import TrueArtefact, simulated_observations
from twin.uncertainty.truth_assumptions import TruthAssumptions

_NODES = (41, 14, 16)  # fine enough for the shortest rail wave along X: eight nodes per pitch
_UM = 1e-3
_RAIL_PITCHES = (0.24, 1.2)  # shortest and longest, in units of half the axis range
_SMOOTH_WAVES = 60
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


def portal_deflection(ranges_mm: Ranges, rng: np.random.Generator) -> DeflectionGrid:
    """Draw the random deflection field of a portal machine. Its cross-beam along X sags between the columns, twists
    under its load and shortens as it bends."""
    (x, y, z), shape = _normalised()
    bow = np.cos(0.5 * np.pi * x)
    sag, twist, pull = rng.uniform((1.0, -3.0, -2.0), (6.0, 3.0, 2.0)) * _UM
    field = np.zeros((*shape, 3))
    field[..., 0] = 0.5 * pull * np.sin(np.pi * x) * (z + 0.4 * y**2)
    field[..., 1] = -twist * bow * z
    field[..., 2] = (twist * y - sag * (1.0 + 0.3 * y)) * bow
    return _grid(ranges_mm, field)


def rail_deflection(ranges_mm: Ranges, rng: np.random.Generator) -> DeflectionGrid:
    """Draw the random deflection field of rails that are wavy between their screws.

    For each axis and direction, the wave is one sine with its own pitch and lever arm.
    """
    positions, shape = _normalised()
    field = np.zeros((*shape, 3))
    for axis in range(3):
        for direction in range(3):
            pitch = np.exp(rng.uniform(*np.log(_RAIL_PITCHES)))
            size, phase, arm = rng.uniform((0.2 * _UM, 0.0, -0.6), (1.0 * _UM, 2.0 * np.pi, 0.6))
            other = positions[(axis + rng.integers(1, 3)) % 3]
            field[..., direction] += size * np.sin(2.0 * np.pi * positions[axis] / pitch + phase) * (1.0 + arm * other)
    return _grid(ranges_mm, field)


def thermal_deflection(ranges_mm: Ranges, rng: np.random.Generator) -> DeflectionGrid:
    """Draw the random deflection field of a thermally bowed bed and of a column that is warmer at its foot. The field
    includes the effect of bed and column on the parts that they carry."""
    (x, y, z), shape = _normalised()
    bed, foot, nod, lean, sway, roll = rng.uniform(-3.0, 3.0, 6) * _UM
    field = np.zeros((*shape, 3))
    field[..., 0] = nod * x * z * (1.0 - 0.3 * x**2) + 0.5 * lean * z**2 * y
    field[..., 1] = 0.5 * sway * y**2 * z + lean * z**2 * (1.0 + 0.5 * np.tanh(2.0 * x))
    field[..., 2] = bed * x**2 * (1.0 + 0.4 * z) + foot * np.expm1(-1.5 * (z + 1.0)) + 0.5 * roll * x * y**2
    return _grid(ranges_mm, field)


def smooth_random_deflection(ranges_mm: Ranges, rng: np.random.Generator) -> DeflectionGrid:
    """Draw a random deflection field without structure. The field consists of plane waves with one correlation length,
    which is 0.2 to 0.8 of the axis ranges."""
    positions, shape = _normalised()
    flat = np.stack(positions, axis=-1).reshape(-1, 3)
    length = np.exp(rng.uniform(*np.log((0.4, 1.6))))
    field = np.zeros((len(flat), 3))
    for direction in range(3):
        waves = rng.standard_normal((3, _SMOOTH_WAVES)) / length
        field[:, direction] = np.cos(flat @ waves + rng.uniform(0.0, 2.0 * np.pi, _SMOOTH_WAVES)).sum(axis=1)
    field *= rng.uniform(0.7, 3.0) * _UM / np.sqrt(np.mean(np.sum(field**2, axis=1)))
    return _grid(ranges_mm, field.reshape(*shape, 3))


def _normalised() -> tuple[tuple[Array, Array, Array], tuple[int, int, int]]:
    """Return the node positions along X, Y, Z, each normalised to [-1, 1], and the shape of the grid."""
    x, y, z = np.meshgrid(*(np.linspace(-1.0, 1.0, count) for count in _NODES), indexing="ij")
    return (x, y, z), _NODES


def _grid(ranges_mm: Ranges, field: Array) -> DeflectionGrid:
    x, y, z = (np.linspace(low, high, count) for (low, high), count in zip(ranges_mm, _NODES, strict=True))
    return DeflectionGrid(x, y, z, field)


MakeDeflection = Callable[[Ranges, np.random.Generator], DeflectionGrid]
_DRAW_FUNCTIONS: Mapping[str, MakeDeflection] = {
    "rails": rail_deflection,
    "smooth": smooth_random_deflection,
    "portal": portal_deflection,
    "thermal": thermal_deflection,
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

    def measure(
        self,
        planned: Observations,
        artefacts: Artefact,
        rng: np.random.Generator,
        true_artefact: TrueArtefact | None = None,
    ) -> Observations:
        """Simulate the measurement of the `planned` balls on this machine, and return the observations. The true
        artefact is drawn unless it is given.

        As in a real measurement, the covariance in the observations is the stated covariance of the ball centres, not
        the true one.
        """
        true = replace(planned, covariance=self.noise**2 * planned.covariance)
        seen = simulated_observations(true, artefacts, self.truth, self.assumptions, rng, true_artefact)
        return replace(seen, covariance=planned.covariance)

    def changed(self, share: float, rng: np.random.Generator) -> RandomMachine:
        """Return this machine after a random change of its errors, under the same conditions.

        `share` is the standard deviation of the change of each parameter, relative to its standard deviation in the
        family. Raises DataError if it is negative or not finite.
        """
        if not (np.isfinite(share) and share >= 0.0):
            raise DataError(f"the change of a machine must be a finite number of at least 0, not {share:g}")
        step = (
            share * self.assumptions.family.prior_standard_deviation * rng.standard_normal(len(self.truth.parameters))
        )
        return replace(self, truth=replace(self.truth, parameters=self.truth.parameters + step))


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
