"""A night to come as the mathematics sees it: tools, artefact, positions, and how it will be identified."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.collision.bodies import ProbeGeometry
from twin.collision.measuring_layout import MeasuringLayout
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.identification import Estimate, Options, identify
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_population import Family

AS_STATED = Options(estimate_scales=False, outliers="none")
"""Nothing is measured yet: noise, prior and misfit are taken as stated."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """`positions` name the tool that measures them; None is the first of the procedure."""

    model: ErrorModel
    family: Family
    procedure: Procedure
    positions: tuple[Position, ...]
    options: Options = AS_STATED

    @property
    def first_tool(self) -> str:
        return next(iter(self.procedure.layouts))

    @property
    def tool_axis(self) -> int:
        """Axis along which the first tool is longest; where it has no length, the axis that carries it."""
        offset = np.abs(self.procedure.layout().tool_offset_mm)
        if offset.any():
            return int(offset.argmax())
        return AXES.index(self.model.chain.axes[0])

    def plan(self) -> PlannedMeasurement:
        """The balls that will be measured. DataError where none is within reach."""
        return self.procedure.plan(self.positions)

    def estimate(self) -> Estimate:
        """What will be known, from where the balls will be: the covariance of the night to come.

        Raises DataError where nothing is within reach, SingularSet for a set that cannot determine anything.
        """
        return identify(self.model, self.plan().observations, self.procedure.artefact, self.family, self.options)

    def first_positions(self) -> tuple[Position, ...]:
        """The positions that the first tool measures."""
        return tuple(p for p in self.positions if p.tool in (None, self.first_tool))

    def with_positions(self, positions: Iterable[Position]) -> SetUp:
        """The same and further positions."""
        return replace(self, positions=(*self.positions, *positions))

    def with_tool(self, name: str, tool_offset: Array) -> SetUp:
        """The same, and what the first tool measures once more with another tool; every position is placed anew."""
        layouts = {**self.procedure.layouts, name: layout_for(self.procedure.layout(), tool_offset, self.tool_axis)}
        procedure = replace(self.procedure, layouts=layouts)
        return replace(self, procedure=procedure).with_positions(replace(p, tool=name) for p in self.first_positions())


def layout_for(layout: MeasuringLayout, tool_offset: Array, tool_axis: int) -> MeasuringLayout:
    """The layout of another tool offset (3,) mm, its probe longer or shorter by the difference along the tool axis.

    What is in the way is judged for a straight probe, and for no shorter one than stem and body of the layout's.
    """
    longer = float((np.abs(tool_offset) - np.abs(layout.tool_offset_mm))[tool_axis])
    reach_mm = max(layout.probe.reach_mm + longer, shortest_reach_mm(layout.probe))
    return replace(
        layout,
        tool_offset_mm=np.asarray(tool_offset, dtype=np.float64),
        probe=replace(layout.probe, reach_mm=reach_mm),
    )


def shortest_reach_mm(probe: ProbeGeometry) -> float:
    """Of a probe with this stem and body."""
    return probe.stem_length_mm + 2.0 * probe.body_radius_mm
