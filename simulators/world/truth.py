"""The machine as it is: known to the simulator, never to the agent.

It has effects that the identified model cannot represent: a higher Legendre order and a deflection grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from drivers.roles import TableImage
from simulators.world.field import TableField
from twin.arrays import Array
from twin.deflection import DeflectionGrid
from twin.error_model import ErrorModel
from twin.family import family_from_amplitudes
from twin.machine_description import MachineDescription
from twin.machine_model import exact_deviation
from twin.volumetric import evaluation_grid, volumetric_error


@dataclass(frozen=True, eq=False)
class TrueMachine:
    """`model` None: a machine without error. `parameters` (p,) of its own, richer model."""

    model: ErrorModel | None
    parameters: Array
    tool_offset: Array
    deflection: DeflectionGrid | None

    def deviation(self, bare_positions: Array) -> Array:
        """(n, 3) mm of the tool centre point at bare axis positions (n, 3)."""
        total = np.zeros_like(bare_positions)
        if self.model is not None:
            total += exact_deviation(self.model, bare_positions, self.tool_offset, self.parameters)
        if self.deflection is not None:
            lower = [nodes[0] for nodes in self.deflection.nodes]
            upper = [nodes[-1] for nodes in self.deflection.nodes]
            total += self.deflection.at(np.clip(bare_positions, lower, upper))
        return total

    @property
    def is_perfect(self) -> bool:
        return self.model is None and self.deflection is None


class Truth:
    """What only the simulator can say of its machine. `banks` are the controller's own, not a copy."""

    def __init__(self, machine: TrueMachine, nominal: ErrorModel, banks: Mapping[int, TableImage]) -> None:
        self.machine = machine
        self._banks = banks
        self._grid = evaluation_grid(nominal.ranges_mm)

    def true_volumetric_error(self, bank: int | None = None) -> tuple[float, float]:
        """(raw, rigidly aligned) rms in µm on the 60×20×20 grid with the table of `bank`; None or 0: bare."""
        displayed = self._grid
        correction = np.zeros_like(displayed)
        if bank:
            if bank not in self._banks:
                raise InputError(f"bank {bank} holds no table", hint=f"filled banks: {sorted(self._banks)}")
            correction = TableField(self._banks[bank]).at_many(displayed)
        deviation = correction + self.machine.deviation(displayed + correction)
        result = volumetric_error(displayed + self.machine.tool_offset, deviation)
        return result.raw_um, result.aligned_um


def draw_machine(
    description: MachineDescription,
    tool: str,
    *,
    order: int,
    scale: float,
    with_deflection: bool,
    rng: np.random.Generator,
) -> TrueMachine:
    """One machine of the family extended to Legendre `order`, its amplitudes decaying as the family's do."""
    offset = description.tool(tool)
    nominal = description.model
    model = ErrorModel.uniform(nominal.chain, nominal.ranges_mm, order, nominal.cross_effect)
    parameters = scale * family_from_amplitudes(model, description.amplitudes).draw(rng, 1)[0]
    return TrueMachine(model, parameters, offset, description.deflection if with_deflection else None)


def perfect_machine(description: MachineDescription, tool: str) -> TrueMachine:
    return TrueMachine(None, np.zeros(0), description.tool(tool), None)
