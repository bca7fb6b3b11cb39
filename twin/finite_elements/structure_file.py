"""Structure file (TOML): a moving-column machine with a bed, a column and a ram as ribbed boxes on elastic joints.

Lengths are in mm. X runs along the bed, the ram reaches out in +Y, Z points upwards. The column stands in the middle of
the bed's width; its carriage runs on its front face.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from twin.arrays import Array
from twin.errors import DataError
from twin.formats.toml_reading import StrictModel, read_toml

Length = Annotated[float, Field(gt=0.0, le=50_000.0)]
Coordinate = Annotated[float, Field(ge=-50_000.0, le=50_000.0)]
Mass = Annotated[float, Field(ge=0.0, le=200_000.0)]
Stiffness = Annotated[float, Field(ge=1.0, le=1e6)]
Nodes = Annotated[int, Field(ge=2, le=60)]
MOST_BAYS = 40
MOST_ELEMENTS = 1300
"""Elements of one part: about 45,000 unknowns. With 39,000, 1.2 GB were measured, whatever the number of nodes."""


class GridNodesSection(StrictModel):
    """Section with the nodes of the grid: lower end, upper end and number of nodes of each axis."""

    x_mm: tuple[Coordinate, Coordinate, Nodes]
    y_mm: tuple[Coordinate, Coordinate, Nodes]
    z_mm: tuple[Coordinate, Coordinate, Nodes]

    @model_validator(mode="after")
    def _ascends(self) -> GridNodesSection:
        for name, (low, high, _) in self.axes.items():
            if not low < high:
                raise ValueError(f"{name} must be [lower end, upper end, nodes], not from {low:g} to {high:g}")
        return self

    @property
    def axes(self) -> dict[str, tuple[float, float, int]]:
        return {"x_mm": self.x_mm, "y_mm": self.y_mm, "z_mm": self.z_mm}

    @property
    def nodes(self) -> tuple[Array, Array, Array]:
        """Nodes in mm along X, Y and Z."""
        x, y, z = (np.linspace(low, high, count) for low, high, count in self.axes.values())
        return x, y, z


class MaterialSection(StrictModel):
    """Section with a material; steel unless stated otherwise."""

    youngs_modulus_gpa: Annotated[float, Field(ge=1.0, le=1000.0)] = 210.0
    poissons_ratio: Annotated[float, Field(ge=0.0, le=0.45)] = 0.3
    density_kg_m3: Annotated[float, Field(ge=100.0, le=20_000.0)] = 7850.0


class BoxSection(StrictModel):
    """Section with the shape that bed, column and ram have in common: a box with walls and ribs across it."""

    wall_mm: Length
    rib_mm: Length
    rib_pitch_mm: Length
    material: MaterialSection = MaterialSection()

    def check(self, length: float, *across: float) -> None:
        """Raise ValueError if the walls or the ribs do not fit into the box."""
        if min(across) <= 2.0 * self.wall_mm:
            raise ValueError(f"walls of {self.wall_mm:g} mm leave no hollow in {min(across):g} mm")
        if self.rib_pitch_mm <= 2.0 * self.rib_mm:
            raise ValueError(f"ribs of {self.rib_mm:g} mm do not fit into a pitch of {self.rib_pitch_mm:g} mm")
        if length <= 4.0 * self.rib_mm:
            raise ValueError(f"ribs of {self.rib_mm:g} mm do not fit into a length of {length:g} mm")
        if length / self.rib_pitch_mm > MOST_BAYS:
            raise ValueError(f"at most {MOST_BAYS} ribs; raise rib_pitch_mm above {length / MOST_BAYS:.0f}")


class BedSection(BoxSection):
    """Section for the bed along X. It stands on pads at `supports_mm`, two beside each other at each place, which
    together have the stiffness `support_n_per_um`. The saddle with the column runs on two trucks."""

    from_mm: Coordinate
    to_mm: Coordinate
    width_mm: Length
    height_mm: Length
    supports_mm: Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=40)]
    support_pad_mm: Length = 150.0
    support_n_per_um: Stiffness
    wheelbase_mm: Length
    truck_mm: Length
    saddle_kg: Mass = 0.0

    @model_validator(mode="after")
    def _fits(self) -> BedSection:
        self.check(self.to_mm - self.from_mm, self.width_mm, self.height_mm)
        if not all(low < high for low, high in pairwise(self.supports_mm)):
            raise ValueError("supports_mm must ascend")
        half = 0.5 * self.support_pad_mm
        if self.supports_mm[0] - half < self.from_mm or self.supports_mm[-1] + half > self.to_mm:
            raise ValueError(f"the pads at supports_mm must lie between {self.from_mm:g} and {self.to_mm:g}")
        return self


class ColumnSection(BoxSection):
    """Section for the column along Z. The axis of the ram is `foot_mm` above the foot if Z is at the lower end of the
    grid. The foot rests on the saddle with the stiffness `foot_n_per_um`; along its face the share `shear_share` of it
    acts. The carriage runs on two pads, one above the other, on each rail."""

    height_mm: Length
    width_mm: Length
    depth_mm: Length
    foot_mm: Length
    foot_n_per_um: Stiffness
    shear_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    pad_pitch_mm: Length
    pad_mm: Length
    carriage_kg: Mass = 0.0
    carriage_centre_mm: Annotated[float, Field(ge=0.0, le=10_000.0)] = 0.0

    @model_validator(mode="after")
    def _fits(self) -> ColumnSection:
        self.check(self.height_mm, self.width_mm, self.depth_mm)
        return self


class RamSection(BoxSection):
    """Section for the ram along Y. It reaches `overhang_mm` out of its guide if Y is at the lower end of the grid.
    The front edge of the guide is `guide_front_mm` before the column. The guide has pads at both ends, on all four
    sides, each with the stiffness `pad_n_per_um`. The head is `head_centre_mm` before the end of the ram; the tool
    point is `tool_mm` (X, Y, Z) from this end."""

    length_mm: Length
    width_mm: Length
    height_mm: Length
    overhang_mm: Length
    guide_mm: Length
    guide_front_mm: Annotated[float, Field(ge=0.0, le=10_000.0)] = 0.0
    pad_mm: Length
    pad_n_per_um: Stiffness
    shear_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.2
    head_kg: Mass = 0.0
    head_centre_mm: Coordinate = 0.0
    tool_mm: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _fits(self) -> RamSection:
        self.check(self.length_mm, self.width_mm, self.height_mm)
        if self.guide_mm < 2.0 * self.pad_mm:
            raise ValueError(f"a guide of {self.guide_mm:g} mm has no room for two pads of {self.pad_mm:g} mm")
        return self


class StructureSection(StrictModel):
    """Contents of a structure file. `count_own_weight` adds the deflection of bed and column by their own weight, which
    does not change if the axes move: their rails were aligned with it, so it is left out unless asked for."""

    name: Annotated[str, Field(min_length=1, max_length=80)]
    grid: GridNodesSection
    bed: BedSection
    column: ColumnSection
    ram: RamSection
    count_own_weight: bool = False
    cells: Annotated[int, Field(ge=1, le=4)] = 1

    @model_validator(mode="after")
    def _travels_fit(self) -> StructureSection:
        (x_low, x_high, _), (y_low, y_high, _), (z_low, z_high, _) = self.grid.axes.values()
        half = 0.5 * (self.bed.wheelbase_mm + self.bed.truck_mm)
        if x_low - half < self.bed.from_mm or x_high + half > self.bed.to_mm:
            needed = f"{x_low - half:g} to {x_high + half:g}"
            raise ValueError(f"the trucks leave the bed: it must reach from {needed} mm")
        half = 0.5 * (self.column.pad_pitch_mm + self.column.pad_mm)
        top = self.column.foot_mm + z_high - z_low + half
        if self.column.foot_mm < half or top > self.column.height_mm:
            raise ValueError(f"the carriage leaves the column: foot_mm >= {half:g} and height_mm >= {top:g} are needed")
        needed_length = self.ram.overhang_mm + y_high - y_low + self.ram.guide_mm
        if self.ram.length_mm < needed_length:
            raise ValueError(f"the ram leaves its guide: length_mm >= {needed_length:g} is needed")
        return self


def check_elements(structure: StructureSection) -> None:
    """Raise DataError if a part would have so many elements that its equations need too much memory."""
    bed, column, ram = structure.bed, structure.column, structure.ram
    lengths = (("bed", bed, bed.to_mm - bed.from_mm), ("column", column, column.height_mm), ("ram", ram, ram.length_mm))
    for name, part, length in lengths:
        bays = math.ceil(length / part.rib_pitch_mm)
        whole = (structure.cells + 2) ** 2
        count = bays * structure.cells * (whole - structure.cells**2) + (bays + 1) * whole
        if count > MOST_ELEMENTS:
            message = f"the {name} would have {count} elements, at most {MOST_ELEMENTS} are solved"
            raise DataError(message, hint=f"Lower cells, or raise rib_pitch_mm of the {name}")


def parse_structure(text: str, source: str) -> StructureSection:
    """Return the structure described by TOML text. Raises FormatError, which names the file and the key."""
    return read_toml(text, source, StructureSection)
