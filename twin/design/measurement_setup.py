"""Mathematical description of a planned measurement: tools, artefact, positions and options of the identification."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.identification import Estimate, Options, identify
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_population import Family

AS_STATED = Options(estimate_scales=False, outliers="none")
"""Options for planning. Nothing has been measured yet, so the scales of noise, prior and misfit are not estimated."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """Planned measurement of a machine. `procedure` contains the tools and the location of the artefact for each tool,
    and `family` is the prior population of machines.

    Each position in `positions` names its tool. If the name is None, the position is measured with the first tool of
    `procedure`.
    """

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
        """Index of the machine axis along which the offset of the first tool of the set-up is largest. If this offset
        is zero, the result is the index of the axis that carries the tool."""
        offset = np.abs(self.procedure.layout().tool_offset_mm)
        if offset.any():
            return int(offset.argmax())
        return AXES.index(self.model.chain.axes[0])

    def plan(self) -> PlannedMeasurement:
        """Return the planned measurement: the positions, and the ball centres that an error-free machine would measure.
        Raise DataError if no position can be measured."""
        return self.procedure.plan(self.positions)

    def estimate(self) -> Estimate:
        """Return the estimate that would follow from the planned ball centres on a machine without errors. Its
        covariance predicts the covariance of the estimate from the real measurement.

        Raise DataError if no position can be measured, and SingularSet if the measurements do not determine the
        parameters.
        """
        return identify(self.model, self.plan().observations, self.procedure.artefact, self.family, self.options)

    def first_positions(self) -> tuple[Position, ...]:
        """Return the positions measured with the first tool of the set-up."""
        return tuple(p for p in self.positions if p.tool in (None, self.first_tool))

    def with_positions(self, positions: Iterable[Position]) -> SetUp:
        """Return the set-up with the given positions added."""
        return replace(self, positions=(*self.positions, *positions))

    def with_tool(self, name: str, tool_offset: Array) -> SetUp:
        """Return a set-up that has a further tool called `name` and measures the positions of its first tool again with
        this further tool. The measuring layout of the further tool is planned for its offset `tool_offset` (3,) in
        mm."""
        layouts = {**self.procedure.layouts, name: layout_for(self.procedure.layout(), tool_offset, self.tool_axis)}
        procedure = replace(self.procedure, layouts=layouts)
        return replace(self, procedure=procedure).with_positions(replace(p, tool=name) for p in self.first_positions())


def layout_for(layout: MeasuringLayout, tool_offset: Array, tool_axis: int) -> MeasuringLayout:
    """Return the measuring layout for a tool other than that of `layout`, with the offset `tool_offset` (3,) in mm. The
    length of the probe changes by the difference of the two tool offsets along the machine axis with the index
    `tool_axis`.

    The collision check assumes a straight probe. The length of this probe is at least the stem length plus the body
    diameter of the probe in `layout`.
    """
    longer = float((np.abs(tool_offset) - np.abs(layout.tool_offset_mm))[tool_axis])
    reach_mm = max(layout.probe.reach_mm + longer, shortest_reach_mm(layout.probe))
    return replace(
        layout,
        tool_offset_mm=np.asarray(tool_offset, dtype=np.float64),
        probe=replace(layout.probe, reach_mm=reach_mm),
    )


def shortest_reach_mm(probe: ProbeGeometry) -> float:
    """Return the shortest possible length in mm of a probe with the stem and the body of `probe`: the length of the
    stem plus the diameter of the body."""
    return probe.stem_length_mm + 2.0 * probe.body_radius_mm
