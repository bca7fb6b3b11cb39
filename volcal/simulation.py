"""Simulated measurements: a random machine, and the ball centres that would be measured on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points
from twin.artefact.position_set import Position
from twin.display import Displayed
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.machine.true_machine import TrueMachine
from twin.uncertainty.random_machines import AS_MODELLED, DEFLECTION_FORMS, draw_random_machine
from volcal.measuring_setup import MeasuringSetup

DEFLECTIONS = (AS_MODELLED, *DEFLECTION_FORMS)


@dataclass(frozen=True, eq=False)
class Simulation(Displayed):
    """Result of a simulated measurement: the ball centres, and the true machine, which is unknown in a real
    measurement.
    """

    balls: BallFile
    true_machine: TrueMachine

    def __repr__(self) -> str:
        return f"<Simulation: {self.balls.observations.size} ball centres in {len(self.balls.positions)} positions>"

    def true_error(self, points_mm: ArrayLike) -> Array:
        """Return the true deviations of the tool centre point, shape (n, 3), at n axis positions, shape (n, 3), both in
        mm.
        """
        return self.true_machine.deviation(as_points(points_mm, "points"))


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
    chosen = setup.position_set(positions) if isinstance(positions, str) else tuple(positions)
    planned = setup.procedure.plan(chosen)
    drawn = draw_random_machine(setup.machine, setup.tool_offset_mm, deflection, rng)
    measured = drawn.measure(planned.observations, setup.artefact, rng)
    return Simulation(BallFile(measured, planned.positions), drawn.truth)
