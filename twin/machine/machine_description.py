"""Description of a machine for the error model, the planner and the simulator. It is read from a machine file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from twin.arrays import Array, as_vector
from twin.display import Displayed
from twin.errors import ModelError
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import ERROR_MOTIONS, ErrorModel, Ranges
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_population import Family, family_from_amplitudes
from twin.machine.mounting import Mounting, require_shoes_within_travel
from twin.machine.structure import DerivedTerm, StructuralBeam

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class MachineDescription(Displayed):
    """Complete description of one machine.

    `model` contains the kinematic chain and the axis ranges. `limits` contains the travel limits in mm, which include
    the axis ranges. `tools` maps the name of each tool to its offset (3,) in mm from the reference point of the ram to
    the stylus centre. `amplitudes` contains the half-widths, as written in the machine file, of the parameters in the
    family of machines (the prior population). From these half-widths the family can also be built for a different
    Legendre order. `derived_terms` contains all terms of the cross-effect that follow from the beams of the machine,
    the redundant ones included, and `beams` contains these beams; both are empty if the machine file states no beams.
    `mounting` contains its feet and the guides of its axes.
    """

    name: str
    model: ErrorModel
    limits: Ranges
    rapid_mm_per_min: Triple
    feed_mm_per_min: Triple
    acceleration_mm_per_s2: Triple
    tools: Mapping[str, Array] = field(hash=False)
    family: Family
    amplitudes: Mapping[str, float | Sequence[float]] = field(hash=False)
    deflection: DeflectionGrid | None
    derived_terms: tuple[DerivedTerm, ...] = ()
    beams: tuple[StructuralBeam, ...] = ()
    mounting: Mounting = field(default_factory=Mounting)

    def __repr__(self) -> str:
        return f"<MachineDescription: {self.name!r}, {self.model.chain}, tools {', '.join(sorted(self.tools))}>"

    def __post_init__(self) -> None:
        for axis, (low, high), travel in zip(AXES, self.model.ranges_mm, self.limits, strict=True):
            if not travel[0] <= low < high <= travel[1]:
                message = f"range [{low:g}, {high:g}] exceeds the travel [{travel[0]:g}, {travel[1]:g}]"
                raise ModelError(message, key=f"axes.{axis}.travel_mm")
        require_shoes_within_travel(self.mounting, self.model.ranges_mm)
        if not self.tools:
            raise ModelError("the machine has no tool", hint="Define at least one, such as [tools.probe]")
        for name, offset in self.tools.items():
            as_vector(offset, 3, f"offset of tool {name}")
        if self.deflection is not None and not self.deflection.covers(self.limits):
            spans = ", ".join(
                f"{axis} {nodes[0]:g} to {nodes[-1]:g}" for axis, nodes in zip(AXES, self.deflection.nodes, strict=True)
            )
            hint = "The grid is not extrapolated: export it over the whole travel"
            message = f"the deflection grid ({spans} mm) does not cover the travel"
            raise ModelError(message, hint=hint, key="deflection.grid")

    def with_order(self, order: int) -> MachineDescription:
        """Return the same machine with one Legendre order for all 18 error motions.

        The family of machines (prior population) is computed from `amplitudes` for that order.
        """
        orders = dict.fromkeys(ERROR_MOTIONS, order)
        return self.with_model(self.model.with_orders(orders))

    def with_model(self, model: ErrorModel) -> MachineDescription:
        """Return the same machine described by a different error model.

        Raises ModelError if the kinematic chain or the axis ranges of the other model differ.
        """
        if (model.chain, model.ranges_mm) != (self.model.chain, self.model.ranges_mm):
            raise ModelError(
                f"the model does not belong to the machine {self.name}: its chain or its axis ranges differ"
            )
        return replace(self, model=model, family=family_from_amplitudes(model, self.amplitudes))

    def tool(self, name: str) -> Array:
        """Return the offset (3,) in mm of the tool called `name`.

        Raises ModelError, which lists the known tools, if there is no such tool.
        """
        if name not in self.tools:
            raise ModelError(f"the machine has no tool '{name}'", hint=f"Known tools: {', '.join(self.tools)}")
        return self.tools[name]
