"""Simulated measurements: a random machine, and the ball centres that would be measured on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points
from twin.artefact.position_set import Position
from twin.compensation.controllers.export_format import ControllerExport
from twin.compensation.table import CompensationTable
from twin.display import Displayed
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.machine.true_machine import TrueMachine
from twin.machine.volumetric import evaluation_grid, rigid_part
from twin.uncertainty.monte_carlo import TrueArtefact, draw_artefact
from twin.uncertainty.random_machines import AS_MODELLED, DEFLECTION_FORMS, RandomMachine, draw_random_machine
from volcal.measuring_setup import MeasuringSetup

DEFLECTIONS = (AS_MODELLED, *DEFLECTION_FORMS)


@dataclass(frozen=True, eq=False)
class Simulation(Displayed):
    """Result of a simulated measurement: the ball centres, and the true machine, which is unknown in a real
    measurement.

    `setup` is the set-up that was simulated. `random_machine` contains the true machine together with the true
    conditions of the measurement, and `true_artefact` the true artefact with the error of its thermometer.
    """

    balls: BallFile
    setup: MeasuringSetup
    random_machine: RandomMachine
    true_artefact: TrueArtefact

    def __repr__(self) -> str:
        return f"<Simulation: {self.balls.observations.size} ball centres in {len(self.balls.positions)} positions>"

    @property
    def true_machine(self) -> TrueMachine:
        """True machine of the simulation."""
        return self.random_machine.truth

    def true_error(
        self, points_mm: ArrayLike, *, table: CompensationTable | ControllerExport | None = None, aligned: bool = False
    ) -> Array:
        """Return the true deviations of the tool centre point, shape (n, 3), at n axis positions, shape (n, 3), both in
        mm.

        With `table`, a compensation table or its export to a controller, these are the deviations that remain while it
        is active. If `aligned` is True, the rigid motion that fits the deviations of the whole workspace best is
        removed, as in `predict`.

        >>> simulation = volcal.simulate(setup, "S3", seed=2)
        >>> table = volcal.compensation_table(volcal.identify(simulation.balls, setup.machine, setup.artefact), balls)
        >>> corner = [[4000.0, 1300.0, 1500.0]]
        >>> without, remaining = (simulation.true_error(corner, table=one, aligned=True) for one in (None, table))
        >>> bool(np.linalg.norm(remaining) < np.linalg.norm(without))
        True
        """
        points = as_points(points_mm, "points")
        deviation = self._deviation(points, table)
        if not aligned:
            return deviation
        offset = self.true_machine.tool_offset
        grid = evaluation_grid(self.setup.machine.model.ranges_mm)
        return deviation - rigid_part(grid + offset, self._deviation(grid, table), points + offset)

    def _deviation(self, points: Array, table: CompensationTable | ControllerExport | None) -> Array:
        if table is None:
            return self.true_machine.deviation(points)
        corrections = table.at(points) if isinstance(table, CompensationTable) else table.correction(points)
        return corrections + self.true_machine.deviation(points + corrections)

    def measure_again(
        self, positions: Sequence[Position] | str = "S3", *, seed: int = 2, change: float = 0.0
    ) -> Simulation:
        """Simulate another measurement of `positions` on the same machine with the same artefact and thermometer.

        If `change` is not 0, the errors of the machine have changed at random since this measurement. `change` is the
        standard deviation of this change, relative to that of the machine's errors in the prior population. The same
        `seed` always gives the same numbers. Raises DataError if no position can be measured.

        >>> first = volcal.simulate(setup, "S1", seed=3)
        >>> second = first.measure_again("S1", seed=4)
        >>> second.true_machine is first.true_machine
        True
        """
        rng = np.random.default_rng(seed)
        machine = self.random_machine.changed(change, rng) if change else self.random_machine
        return _measured(self.setup, positions, machine, self.true_artefact, rng)


def simulate(
    setup: MeasuringSetup, positions: Sequence[Position] | str = "S3", *, seed: int = 1, deflection: str = "beams"
) -> Simulation:
    """Draw a random machine from the prior population of machine errors and simulate the measurement of `positions` on
    this machine.

    The machine has errors that the identified model cannot represent: error motions of Legendre order 7, and a
    deflection. `deflection` is one of the forms `none`, `rails`, `smooth`, `portal`, `thermal` and `beams`, where
    `beams` is the deflection of the machine file with a random amplitude, `rails` are wavy rails, `smooth` is a smooth
    random field, `portal` is a sagging cross-beam, and `thermal` is a thermally bowed bed and column. The artefact, the
    thermometer, the drift and the touch noise differ at random from the values that are stated for them.

    With `deflection="as modelled"` the model can represent the machine exactly, and the values stated for artefact,
    thermometer, drift and touch noise are true. The same `seed` always gives the same numbers. Raises DataError if the
    deflection is unknown or if no position can be measured.

    >>> simulation = volcal.simulate(setup, "S1", seed=3)
    >>> simulation.balls.observations.size, simulation.true_error([[0.0, 0.0, 0.0]]).shape
    (78, (1, 3))
    """
    if deflection not in DEFLECTIONS:
        raise DataError(f"unknown deflection '{deflection}'", hint=f"Known: {', '.join(DEFLECTIONS)}")
    rng = np.random.default_rng(seed)
    drawn = draw_random_machine(setup.machine, setup.tool_offset_mm, deflection, rng)
    return _measured(setup, positions, drawn, draw_artefact(setup.artefact, drawn.assumptions, rng), rng)


def _measured(
    setup: MeasuringSetup,
    positions: Sequence[Position] | str,
    machine: RandomMachine,
    true_artefact: TrueArtefact,
    rng: np.random.Generator,
) -> Simulation:
    chosen = setup.position_set(positions) if isinstance(positions, str) else tuple(positions)
    planned = setup.procedure.plan(chosen)
    measured = machine.measure(planned.observations, setup.artefact, rng, true_artefact)
    return Simulation(BallFile(measured, planned.positions), setup, machine, true_artefact)
