"""Deflection grid of a moving-column machine whose bed, column and ram are elastic solids.

The parts meet at rigid saddles: each part answers with the mean motion of its rail, and the motion of the tool point is
the sum of these motions with their lever arms (small displacements, linear elasticity). The loads follow from the
weights alone, since each part carries the next one statically determinately. So each part is solved on its own: the bed
for every position of X, the column for every position of Z, and the ram, whose guide moves along it, once for every
position of Y.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from agent.finite_elements.hollow_box import HollowBox
from agent.finite_elements.pads import Pads
from agent.finite_elements.solid_part import ElasticPads, ElasticPart, Material
from twin.arrays import Array
from twin.finite_elements.structure_file import BoxSection, MaterialSection, StructureSection
from twin.machine.deflection import DeflectionGrid

GRAVITY_N_PER_KG = 9.80665
_N_MM_PER_N_UM = 1e3
_X, _Y, _Z = 0, 1, 2
PARTS = ("bed", "column", "ram")

Progress = Callable[[str], None]


@dataclass(frozen=True)
class _Weight:
    """Mass in kg with its centre of gravity (3,) in mm."""

    mass_kg: float
    centre_mm: Array

    def wrench(self, about_mm: Array) -> Array:
        """Return force and moment (6,) of the weight about a point (3,), in N and N mm."""
        force = np.array([0.0, 0.0, -GRAVITY_N_PER_KG * self.mass_kg])
        return np.concatenate((force, np.cross(self.centre_mm - about_mm, force)))


@dataclass(frozen=True)
class _Answers:
    """Answers of a part at stations: flexibilities (k, 6, 6), and motions (k, 6) by its own weight, about the points
    (k, 3) in mm."""

    flexibility: Array
    by_own_weight: Array
    about_mm: Array


@dataclass(frozen=True)
class SolidDeflection:
    """Deflection grid of a solid model, with the grid and the number of unknowns of each part: bed, column, ram. The
    grids of the parts add up to `grid`."""

    grid: DeflectionGrid
    parts: Mapping[str, DeflectionGrid]
    unknowns: Mapping[str, int]


def solid_deflection(structure: StructureSection, progress: Progress = lambda _: None) -> SolidDeflection:
    """Return the displacements of the tool point under gravity at all nodes of the grid of a structure, relative to the
    ground, in mm. Nothing is subtracted."""
    x, y, z = structure.grid.nodes
    ram_motions, ram, ram_size = _ram(structure, progress)
    progress("column")
    column, part = _column(structure)
    column_weight = _Weight(1e3 * part.mass_t, part.centre_mm)
    progress("bed")
    bed, bed_size = _bed(structure)
    by_part = {name: np.empty((x.size, y.size, z.size, 3)) for name in PARTS}
    for j, k in np.ndindex(y.size, z.size):
        face = column.about_mm[k]
        tip = np.array([0.0, _tip_y(structure, float(y[j] - y[0])), face[_Z]])
        tool = tip + np.array(structure.ram.tool_mm)
        carried = [
            _Weight(ram.mass_kg, tip + ram.centre_mm),
            _Weight(structure.ram.head_kg, tip + np.array([0.0, structure.ram.head_centre_mm, 0.0])),
            _Weight(structure.column.carriage_kg, face + np.array([0.0, structure.column.carriage_centre_mm, 0.0])),
        ]
        on_column = sum((weight.wrench(face) for weight in carried), np.zeros(6))
        of_column = column.flexibility[k] @ on_column + column.by_own_weight[k]
        by_part["ram"][:, j, k] = _moved(ram_motions[j], tool - tip)
        by_part["column"][:, j, k] = _moved(of_column, tool - face)
        origin = np.zeros(3)  # the middle of the saddle, on the bed
        carried += [column_weight, _Weight(structure.bed.saddle_kg, origin)]
        on_bed = sum((weight.wrench(origin) for weight in carried), np.zeros(6))
        for i in range(x.size):
            by_part["bed"][i, j, k] = _moved(bed.flexibility[i] @ on_bed + bed.by_own_weight[i], tool)
    return SolidDeflection(
        grid=DeflectionGrid(x, y, z, sum(by_part.values(), np.zeros((x.size, y.size, z.size, 3)))),
        parts={name: DeflectionGrid(x, y, z, values) for name, values in by_part.items()},
        unknowns=dict(zip(PARTS, (bed_size, part.unknowns, ram_size), strict=True)),
    )


def _moved(motion: Array, arm_mm: Array) -> Array:
    """Return the displacement (3,) of a point at `arm_mm` (3,) from the point to which a motion (6,) belongs."""
    moved: Array = motion[:3] + np.cross(motion[3:], arm_mm)
    return moved


def _tip_y(structure: StructureSection, travel_mm: float) -> float:
    """Return the Y coordinate in mm of the end of the ram, from the middle of the column."""
    ram = structure.ram
    return 0.5 * structure.column.depth_mm + ram.guide_front_mm + ram.overhang_mm + travel_mm


def _bed(structure: StructureSection) -> tuple[_Answers, int]:
    bed = structure.bed
    half = 0.5 * bed.width_mm
    low, high = (bed.from_mm, -half, -bed.height_mm), (bed.to_mm, half, 0.0)
    stand = ElasticPads(
        Pads(_Z, -bed.height_mm, _X, bed.supports_mm, bed.support_pad_mm, half - bed.wall_mm),
        bed.support_n_per_um * _N_MM_PER_N_UM,
        bed.support_n_per_um * _N_MM_PER_N_UM,
    )
    part = ElasticPart(_box(_X, low, high, bed, structure.cells), _material(bed.material), [stand])
    arms = (-0.5 * bed.wheelbase_mm, 0.5 * bed.wheelbase_mm)
    stations = [
        (Pads(_Z, 0.0, _X, tuple(x + arm for arm in arms), bed.truck_mm, half - bed.wall_mm), np.array([x, 0.0, 0.0]))
        for x in structure.grid.nodes[_X].tolist()
    ]
    return _answers(part, stations, structure.count_own_weight), part.unknowns


def _column(structure: StructureSection) -> tuple[_Answers, ElasticPart]:
    column = structure.column
    half, front = 0.5 * column.width_mm, 0.5 * column.depth_mm
    low, high = (-half, -front, 0.0), (half, front, column.height_mm)
    foot = column.foot_n_per_um * _N_MM_PER_N_UM
    stand = ElasticPads(Pads(_Z, 0.0), foot, column.shear_share * foot)
    part = ElasticPart(_box(_Z, low, high, column, structure.cells), _material(column.material), [stand])
    z = structure.grid.nodes[_Z]
    stations = []
    for height in (column.foot_mm + (z - z[0])).tolist():
        pads = (height - 0.5 * column.pad_pitch_mm, height + 0.5 * column.pad_pitch_mm)
        rail = Pads(_Y, front, _Z, pads, column.pad_mm, half - column.wall_mm)
        stations.append((rail, np.array([0.0, front, height])))
    return _answers(part, stations, structure.count_own_weight), part


def _ram(structure: StructureSection, progress: Progress) -> tuple[Array, _Weight, int]:
    """Return the motions (ny, 6) of the end of the ram relative to its guide, and the weight of the ram with its centre
    relative to this end."""
    ram = structure.ram
    wide, high = 0.5 * ram.width_mm, 0.5 * ram.height_mm
    box = _box(_Y, (-wide, -ram.length_mm, -high), (wide, 0.0, high), ram, structure.cells)
    end = np.zeros(3)
    head = _Weight(ram.head_kg, np.array([0.0, ram.head_centre_mm, 0.0])).wrench(end)
    y = structure.grid.nodes[_Y]
    motions, part = [], None
    for number, reach in enumerate((ram.overhang_mm + (y - y[0])).tolist(), start=1):
        progress(f"ram, position {number} of {y.size}")
        part = ElasticPart(box, _material(ram.material), _guide(structure, reach))
        rail = part.rail(Pads(_Y, 0.0), end)
        moved = part.displacements((rail @ head + part.own_weight)[:, None])
        motions.append(rail.T @ moved[:, 0])
    assert part is not None  # noqa: S101  a grid has at least two nodes along every axis
    return np.stack(motions), _Weight(1e3 * part.mass_t, part.centre_mm), part.unknowns


def _guide(structure: StructureSection, reach_mm: float) -> list[ElasticPads]:
    """Return the pads of the guide if the ram reaches `reach_mm` out of it."""
    ram = structure.ram
    centres = (-reach_mm - ram.guide_mm + 0.5 * ram.pad_mm, -reach_mm - 0.5 * ram.pad_mm)
    stiff = ram.pad_n_per_um * _N_MM_PER_N_UM
    found = []
    for axis, across in ((_X, ram.height_mm), (_Z, ram.width_mm)):
        at = 0.5 * (ram.width_mm if axis == _X else ram.height_mm)
        for side in (-at, at):
            pads = Pads(axis, side, _Y, centres, ram.pad_mm, 0.5 * across - ram.wall_mm)
            found.append(ElasticPads(pads, stiff, ram.shear_share * stiff))
    return found


def _answers(part: ElasticPart, stations: list[tuple[Pads, Array]], own_weight: bool) -> _Answers:
    """Return the answers at the stations, solved one after the other: the load vectors of all together would need more
    memory than the equations."""
    by_weight = part.displacements(part.own_weight[:, None])[:, 0] if own_weight else None
    flexibilities, own = [], []
    for pads, about in stations:
        rail = part.rail(pads, about)
        flexibilities.append(rail.T @ part.displacements(rail))
        own.append(np.zeros(6) if by_weight is None else rail.T @ by_weight)
    return _Answers(np.stack(flexibilities), np.stack(own), np.stack([about for _, about in stations]))


def _box(
    axis: int, low: tuple[float, float, float], high: tuple[float, float, float], shape: BoxSection, cells: int
) -> HollowBox:
    return HollowBox(axis, low, high, shape.wall_mm, shape.rib_mm, shape.rib_pitch_mm, cells)


def _material(section: MaterialSection) -> Material:
    return Material(1e3 * section.youngs_modulus_gpa, section.poissons_ratio, 1e-12 * section.density_kg_m3)
