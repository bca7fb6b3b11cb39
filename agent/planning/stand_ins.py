"""Answers that a plan receives where nothing is measured: stand-ins for conclusions, and a store of tables in memory.

Preflight and timing carry out the plan of a run without a machine. The values that a run computes from measurements do
not exist there, and its tables are written to a store that holds them in memory and has the limits of the controller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from agent.execution import steps as s
from agent.execution.engine import Action
from drivers.roles import Activation, StoreLimits, TableImage

STAND_IN_TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((2, 2, 2, 3), dtype=np.int32))
"""Table that a preflight stages in place of the one that will be computed. Only its existence matters."""

USUAL_STORE = StoreLimits(
    banks=(1, 2),
    max_nodes=(1_000, 1_000, 1_000),
    max_total_nodes=1_000_000,
    resolution_mm=1e-4,
    max_correction_mm=1.0,
    activation=Activation.IMMEDIATE,
)
"""Limits of a store with two banks that take effect at once, for a plan that is walked without a controller."""


@dataclass
class MemoryStore:
    """Compensation store in memory. It starts without compensation, and a bank becomes active at once."""

    active: int = 0
    tables: dict[int, TableImage] = field(default_factory=dict)

    def actions(self) -> dict[type, Action]:
        return {
            s.ReadActiveBank: lambda _: self.active,
            s.AwaitActive: lambda _: None,
            s.ReadTable: lambda step: self.tables.get(step.bank),
            s.StageTable: self._stage,
            s.ActivateBank: self._activate,
        }

    def copy(self) -> MemoryStore:
        return MemoryStore(self.active, dict(self.tables))

    def _stage(self, step: s.StageTable) -> None:
        self.tables[step.bank] = step.table

    def _activate(self, step: s.ActivateBank) -> None:
        self.active = step.bank


def stand_in_answers(entered: Callable[[s.Enter], None] = lambda _: None) -> dict[type, Action]:
    """Return the actions that answer the steps of a run with stand-ins. `entered` is called for each state entered."""
    return {
        s.Enter: entered,
        s.Conclude: lambda step: step.stand_in,
        s.ComputeOnce: lambda _: {},
        s.ProvePlan: lambda _: 0.0,
    }
