"""Design of position sets: selection of the artefact positions whose measurement leaves the smallest expected error
after compensation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.artefact.position_set import Position
from twin.design.candidates import build_candidates, orientation_grid
from twin.design.goals import Goal, PositionCountGoal, TargetErrorGoal
from twin.design.measurement_setup import AS_STATED
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch
from twin.design.valuation import Valuation, valuation
from twin.display import Displayed
from twin.errors import DataError
from twin.machine.volumetric import evaluation_grid
from volcal.measuring_setup import MeasuringSetup


@dataclass(frozen=True, eq=False)
class Design(Displayed):
    """Set of artefact positions, and the volumetric errors expected before and after compensation if this set is
    measured.

    `valuation` contains the expected errors. The function `design` orders the positions by station, azimuth and
    elevation. The function `evaluate` keeps the given order.
    """

    positions: tuple[Position, ...]
    valuation: Valuation

    def __repr__(self) -> str:
        return (
            f"<Design: {len(self.positions)} positions, expected {self.valuation.before.aligned_um:.2f} µm, "
            f"{self.valuation.after.aligned_um:.2f} µm after compensation>"
        )


def design(
    setup: MeasuringSetup,
    count: int | None = None,
    *,
    target_vce_um: float | None = None,
    grid_deg: float = 30.0,
    stations: Sequence[int] | None = None,
) -> Design:
    """Choose the artefact positions whose measurement leaves the smallest expected volumetric error after compensation.

    The error is taken after the best rigid motion of the workspace has been removed. Give either `count` or
    `target_vce_um`: `count` is the number of positions, and `target_vce_um` is the error in µm to reach with as few
    positions as possible. The candidates are all orientations on a grid of `grid_deg` in azimuth and elevation, at the
    given `stations`, or at all stations if `stations` is None. Here all positions count as equally costly to measure.
    The command `volcal design` also takes account of the machine time, and checks the paths for collisions. Raises
    DataError if the requested number or error cannot be reached.

    >>> design = volcal.design(setup, 6, grid_deg=45.0)
    >>> len(design.positions)
    6
    >>> design.valuation.after.aligned_um < design.valuation.before.aligned_um
    True
    """
    goal = _goal(count, target_vce_um)
    procedure = setup.procedure
    offered = [
        Position(station, azimuth, elevation)
        for station in stations or procedure.stations
        for azimuth, elevation in orientation_grid(grid_deg)
    ]
    grid = evaluation_grid(setup.machine.model.ranges_mm)
    candidates = build_candidates(procedure, offered, setup.machine.family, AS_STATED, grid, setup.tool_offset_mm)
    codes = np.array([position.station for position in candidates.positions])
    chosen = goal.select(ExchangeSearch(candidates, MeasuringCosts(np.ones(candidates.count), codes)))
    return evaluate(setup, [candidates.positions[index] for index in sorted(chosen)])


def evaluate(setup: MeasuringSetup, positions: Sequence[Position] | str) -> Design:
    """Evaluate a set of artefact positions without a measurement, and return it as a `Design`.

    `positions` contains the positions, or is the name of a set such as `S1+S3`.

    The result contains the volumetric errors that are expected before and after compensation, if the machine is
    identified from these positions.

    >>> volcal.evaluate(setup, "S3").valuation.percent > 50.0
    True
    """
    chosen = setup.position_set(positions) if isinstance(positions, str) else tuple(positions)
    planned = setup.procedure.plan(chosen)
    grid = evaluation_grid(setup.machine.model.ranges_mm)
    family, offset = setup.machine.family, setup.tool_offset_mm
    worth = valuation(family, setup.artefact, planned.observations, AS_STATED, grid, offset)
    return Design(planned.positions, worth)


def _goal(count: int | None, target_vce_um: float | None) -> Goal:
    if count is not None and target_vce_um is None:
        return PositionCountGoal(count)
    if target_vce_um is not None and count is None:
        return TargetErrorGoal(1e-3 * target_vce_um)
    raise DataError("a design has one goal", hint="Give either count or target_vce_um")
