"""Planned measuring procedure: the balls measured in a set of positions of the artefact, and the covariance of the ball
centres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import MIN_BALLS, Position
from twin.collision.measuring_layout import MeasuringLayout
from twin.errors import DataError

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PlannedMeasurement:
    """Measurement planned for a set of positions of the artefact.

    `observations` contains the ball centres that an error-free machine would measure. For each ball centre,
    `observations.position` is the index of its position in `positions`. `left_out` contains the positions with fewer
    than three measurable balls. `unreachable_balls` is the number of unreachable balls, summed over all positions.
    """

    observations: Observations
    positions: tuple[Position, ...]
    left_out: tuple[Position, ...]
    unreachable_balls: int


@dataclass(frozen=True, eq=False)
class Procedure:
    """Tools of a measurement, and the measuring layout for each tool.

    `layouts` contains the layout of each tool by the name of the tool. The first tool measures all positions that name
    no tool. `covariance_mm2` (3, 3) is the covariance of one measured ball centre.
    """

    layouts: Mapping[str, MeasuringLayout]
    covariance_mm2: Array

    @property
    def artefact(self) -> Artefact:
        return self.layout().artefact

    @property
    def stations(self) -> tuple[int, ...]:
        return tuple(sorted(self.layout().locations_mm))

    @property
    def tool_offsets(self) -> Array:
        """Tool offsets (T, 3) in mm of the T tools, in the order of `layouts`."""
        return np.array([layout.tool_offset_mm for layout in self.layouts.values()])

    def layout(self, tool: str | None = None) -> MeasuringLayout:
        """Return the measuring layout of `tool`, or the layout of the first tool if `tool` is None. Raise DataError if
        the tool is unknown."""
        if tool is None:
            return next(iter(self.layouts.values()))
        if tool not in self.layouts:
            raise DataError(f"tool '{tool}' is not part of the procedure", hint=f"tools: {', '.join(self.layouts)}")
        return self.layouts[tool]

    def with_artefact(self, artefact: Artefact) -> Procedure:
        """Return the procedure with a different artefact. The new artefact is used at all stations, also at those that
        had their own artefact."""
        layouts = {name: replace(layout, artefact=artefact, own_artefacts={}) for name, layout in self.layouts.items()}
        return replace(self, layouts=layouts)

    def balls_of(self, position: Position) -> tuple[IndexArray, Array]:
        """Return the indices (m,) and the nominal axis positions (m, 3) in mm of the m balls that can be measured in
        the artefact position `position`."""
        layout = self.layout(position.tool)
        nominal = layout.nominal(position)
        balls = np.flatnonzero(layout.reachable(position, nominal))
        return balls + layout.first_ball(position.station), nominal[balls]

    def plan(self, positions: Sequence[Position]) -> PlannedMeasurement:
        """Return the planned measurement of the artefact positions `positions`. Raise DataError if no position can be
        measured."""
        used: list[Position] = []
        found: list[tuple[IndexArray, Array]] = []
        left_out: list[Position] = []
        unreachable = 0
        for position in positions:
            balls, nominal_positions = self.balls_of(position)
            unreachable += self.layout(position.tool).asked_balls(position) - len(balls)
            if len(balls) < MIN_BALLS:
                left_out.append(position)
                continue
            used.append(position)
            found.append((balls, nominal_positions))
        if not used:
            raise DataError(
                f"none of the {len(positions)} positions has three balls within reach",
                hint="check stations, mount, tool offset and axis travel, or choose other orientations",
            )
        return PlannedMeasurement(self._observations(used, found), tuple(used), tuple(left_out), unreachable)

    def _observations(self, positions: list[Position], found: list[tuple[IndexArray, Array]]) -> Observations:
        names = list(self.layouts)
        counts = [len(balls) for balls, _ in found]
        total = sum(counts)
        tools = [0 if position.tool is None else names.index(position.tool) for position in positions]
        elevations = [math.radians(position.elevation_deg) for position in positions]
        return Observations(
            position=np.repeat(np.arange(len(positions)), counts),
            ball=np.concatenate([balls for balls, _ in found]),
            tool=np.repeat(tools, counts),
            axis_positions=np.concatenate([nominal_positions for _, nominal_positions in found]),
            covariance=np.broadcast_to(self.covariance_mm2, (total, 3, 3)),
            # At the reference temperature the artefact has its certified length.
            temperature_c=np.full(total, self.artefact.reference_temperature_c),
            elevation_rad=np.repeat(elevations, counts),
            azimuth_rad=np.repeat([math.radians(position.azimuth_deg) for position in positions], counts),
            tool_offsets=self.tool_offsets,
        )
