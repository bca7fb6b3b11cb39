"""Better places of the stations for a set of artefact positions that has been chosen.

The stations of a design are listed places, but a mount that a person carries can stand anywhere along the axis of the
stations. The search moves one station at a time by a step, along this axis, as long as that lowers the expected error,
and then continues with shorter steps (coordinate descent with a pattern; Hooke and Jeeves 1961). Orientations and balls
stay. An orientation is accessible wherever its station stands, so a trial takes only the equations of the set.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.artefact.position_set import CHECKABLE_BALLS, Position
from twin.design.criterion import Criterion
from twin.design.procedure import Procedure
from twin.identification.centres import CentreEquations
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.scales import Scales
from twin.machine.machine_population import Family

STEP_SHARES = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
"""Steps of a station as shares of the travel of its axis, tried one after the other."""

_ROUNDED_MM = 5.0  # a person reads the places; 5 mm change the error by far less than the search gains
_MIN_DECREASE = 1e-4  # of the expected error: below it a station stays where it is


@dataclass(frozen=True, eq=False)
class StationPlaces:
    """Search for better places of the stations of `positions`, which `procedure` measures.

    `family` and `options` are those of the identification. The expected error counts over the axis positions `grid`
    (n, 3) in mm with the tool offset `tool_offset` (3,) in mm. A station stays within `travel_mm`, the lower and the
    upper end of its axis. The stations in `kept` are not moved.
    """

    procedure: Procedure
    positions: Sequence[Position]
    family: Family
    options: Options
    grid: Array
    tool_offset: Array
    travel_mm: tuple[float, float]
    kept: Collection[int] = ()

    def improved(self) -> Mapping[int, Array]:
        """Return the place (3,) in mm of each station after the search. Stations without a position stay."""
        layout = self.procedure.layout()
        along, (low, high) = layout.station_axis, self.travel_mm
        measured = sorted({position.station for position in self.positions} - set(self.kept))
        places = {station: np.array(place) for station, place in layout.locations_mm.items()}
        least = self.expected_mm(places)
        for share in STEP_SHARES:
            step = max(round(share * (high - low) / _ROUNDED_MM), 1) * _ROUNDED_MM
            moved = True
            while moved:
                moved = False
                for station in measured:
                    for shift in (step, -step):
                        trial = {**places, station: places[station] + shift * np.eye(3)[along]}
                        if not low <= trial[station][along] <= high:
                            continue
                        error = self.expected_mm(trial)
                        if error < (1.0 - _MIN_DECREASE) * least:
                            places, least, moved = trial, error, True
        return places

    def expected_mm(self, places: Mapping[int, Array]) -> float:
        """Return the expected volumetric error after compensation in mm, rigidly aligned, with the stations at
        `places`; inf if a position has fewer balls within reach there than it needs."""
        moved = {name: layout.with_locations(places) for name, layout in self.procedure.layouts.items()}
        procedure = replace(self.procedure, layouts=moved)
        if any(
            len(procedure.balls_of(one)[0]) < least
            for one, least in zip(self.positions, self._least_balls, strict=True)
        ):
            return math.inf
        problem = self._problem(procedure)
        matrix = CentreEquations.build(problem, unit_weights=False).matrix
        precision = PriorPrecision(problem.blocks, problem.known, direct=problem.direct)
        return self._form.expected(Posterior.of(matrix, precision, Scales()).covariance).aligned_mm

    def _problem(self, procedure: Procedure) -> IdentificationProblem:
        return build_problem(self.family, procedure.plan(self.positions).observations, procedure.artefact, self.options)

    @cached_property
    def _form(self) -> Criterion:
        return Criterion.build(self._problem(self.procedure).unknowns, self.grid, self.tool_offset)

    @cached_property
    def _least_balls(self) -> tuple[int, ...]:
        """Least number of balls of each position: as many as now, but no more than a wrong ball needs to be told."""
        return tuple(min(len(self.procedure.balls_of(one)[0]), CHECKABLE_BALLS) for one in self.positions)
