"""True error of the simulated machine. Only the simulator knows this error; the agent never sees it."""

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
    """True error of the machine at its present temperature.

    `banks` maps the numbers of the controller's banks to their compensation tables; it is shared with the controller
    and not copied. `warm_field` is a function that returns the present thermal change of the deviation field, or None.
    The thermal growth of spindle and ram is excluded: it shifts the tip equally at all positions, like a new zero
    point, and a compensation table need not correct such a shift.
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
        """Return two rms lengths of the true error in µm with the compensation table of `bank`, on a grid of 60×20×20
        points in the workspace.

        The first value is the raw error, and the second is the aligned error, which remains after the best-fitting
        rigid motion is removed. If `bank` is None or 0, both values are errors without a compensation table. Raises
        InputError if the bank is empty.
        """
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
