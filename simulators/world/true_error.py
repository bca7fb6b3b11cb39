"""What only the simulator knows of its machine, never the agent: how large its error truly is."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from drivers.errors import InputError
from drivers.roles import TableImage
from simulators.world.field import FieldOfMany, TableField
from twin.machine.error_model import ErrorModel
from twin.machine.true_machine import TrueMachine
from twin.machine.volumetric import evaluation_grid, volumetric_error


class MachineTruth:
    """What only the simulator can say of its machine, as warm as it is when it is asked.

    `banks` are the controller's own, not a copy; `warm_field`: what warmth adds now. The growth of spindle and ram is
    left out: it moves the whole field, as setting the zero anew does, and no table is meant to take it up.
    """

    def __init__(
        self,
        machine: TrueMachine,
        nominal: ErrorModel,
        banks: Mapping[int, TableImage],
        warm_field: Callable[[], FieldOfMany | None] = lambda: None,
    ) -> None:
        self.machine = machine
        self._banks = banks
        self._warm_field = warm_field
        self._grid = evaluation_grid(nominal.ranges_mm)

    def true_volumetric_error(self, bank: int | None = None) -> tuple[float, float]:
        """(raw, rigidly aligned) rms in µm on the 60×20×20 grid with the table of `bank`; None or 0: bare."""
        displayed = self._grid
        correction = np.zeros_like(displayed)
        if bank:
            if bank not in self._banks:
                raise InputError(f"bank {bank} holds no table", hint=f"filled banks: {sorted(self._banks)}")
            correction = TableField(self._banks[bank]).at_many(displayed)
        bare = displayed + correction
        deviation = correction + self.machine.deviation(bare)
        warm = self._warm_field()
        if warm is not None:
            deviation = deviation + warm(bare)
        result = volumetric_error(displayed + self.machine.tool_offset, deviation)
        return result.raw_um, result.aligned_um
