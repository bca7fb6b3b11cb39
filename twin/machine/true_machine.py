"""True machine of a simulation.

The true machine has effects that the error model identified from its measurement cannot represent: Legendre terms of
higher order, and a deflection that is given on a grid of axis positions. A simulator uses one true machine, whereas a
study draws many of them at random.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import ExactDeviation
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import family_from_amplitudes


@dataclass(frozen=True, eq=False)
class TrueMachine:
    """True errors of one machine.

    `model` is None for a machine without parametric errors. `parameters`, shape (p,), contains the values of the p
    parameters of `model`. `tool_offset`, shape (3,), in mm, is the vector from the reference point of the ram to the
    tool centre point. `deflection` contains further displacements of the tool centre point on a grid of axis positions;
    it is None for a machine without deflection.
    """

    model: ErrorModel | None
    parameters: Array
    tool_offset: Array
    deflection: DeflectionGrid | None

    def deviation(self, bare_positions: Array) -> Array:
        """Return the deviation of the tool centre point at n axis positions, without any compensation.

        The axis positions and the deviation have shape (n, 3) and are in mm.
        """
        total = np.zeros_like(bare_positions)
        if self._parametric is not None:
            total += self._parametric.at(bare_positions)
        if self.deflection is not None:
            total += self.deflection.at(np.clip(bare_positions, *self._deflection_limits_mm))
        return total

    @cached_property
    def _parametric(self) -> ExactDeviation | None:
        """Deviation by the parametric errors; None for a machine without them."""
        return None if self.model is None else ExactDeviation(self.model, self.tool_offset, self.parameters)

    @cached_property
    def _deflection_limits_mm(self) -> tuple[Array, Array]:
        """Lower and upper corner, (3,) each in mm, of the grid of the deflection."""
        assert self.deflection is not None  # noqa: S101  narrowed by the caller
        nodes = self.deflection.nodes
        return np.array([one[0] for one in nodes]), np.array([one[-1] for one in nodes])

    @property
    def is_perfect(self) -> bool:
        return self.model is None and self.deflection is None


def draw_machine(
    description: MachineDescription,
    tool: str,
    *,
    order: int,
    scale: float,
    with_deflection: bool,
    rng: np.random.Generator,
) -> TrueMachine:
    """Draw one machine at random from the family that the machine file `description` defines.

    The error motions are Legendre series up to `order`. The machine file gives half-widths for the parameters of the
    lowest orders. For each higher order, the half-width is that of the previous order multiplied by the decay factor of
    the family. All drawn parameters are multiplied by `scale`.
    """
    offset = description.tool(tool)
    nominal = description.model
    model = ErrorModel.uniform(nominal.chain, nominal.ranges_mm, order, nominal.cross_effect, nominal.structure)
    parameters = scale * family_from_amplitudes(model, description.amplitudes).draw(rng, 1)[0]
    return TrueMachine(model, parameters, offset, description.deflection if with_deflection else None)


def perfect_machine(description: MachineDescription, tool: str) -> TrueMachine:
    return TrueMachine(None, np.zeros(0), description.tool(tool), None)
