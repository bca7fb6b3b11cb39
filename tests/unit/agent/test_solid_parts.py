"""The solid model against beams and statics in closed form, and its convergence with finer meshes."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.finite_elements.hollow_box import HollowBox
from agent.finite_elements.machine_structure import solid_deflection
from agent.finite_elements.pads import Pads
from agent.finite_elements.solid_part import ElasticPads, ElasticPart, Material
from drivers.errors import InputError
from twin.errors import FormatError
from twin.finite_elements.structure_file import StructureSection, parse_structure

STRUCTURE = Path(__file__).parents[3] / "config" / "structures" / "case-study.toml"
YOUNG, SHEAR_FREE, DENSITY = 2.0e5, 0.0, 8.0e-9
LENGTH, SIDE, WALL = 2000.0, 100.0, 25.0
GRAVITY = 9806.65
STIFF = 1e12
AREA = SIDE**2 - (SIDE - 2 * WALL) ** 2
SECOND_MOMENT = (SIDE**4 - (SIDE - 2 * WALL) ** 4) / 12.0


def cantilever(cells: int = 1) -> tuple[ElasticPart, Pads, np.ndarray]:
    """Return a slender hollow cantilever from the origin, its free end, and the point in the middle of this end."""
    half = SIDE / 2
    box = HollowBox(1, (-half, 0.0, -half), (half, LENGTH, half), WALL, 2.0, LENGTH / 4, cells)
    part = ElasticPart(box, Material(YOUNG, SHEAR_FREE, DENSITY), [ElasticPads(Pads(1, 0.0), STIFF, STIFF)])
    return part, Pads(1, LENGTH), np.array([0.0, LENGTH, 0.0])


def flexibility(part: ElasticPart, pads: Pads, about: np.ndarray) -> np.ndarray:
    rail = part.rail(pads, about)
    return rail.T @ part.displacements(rail)


def test_a_cantilever_bends_as_the_textbook_says() -> None:
    """P L³/3EI, P L²/2EI and M L/EI; shear adds about (h/L)² of them."""
    part, end, tip = cantilever()
    answer = flexibility(part, end, tip)
    bending = YOUNG * SECOND_MOMENT
    assert answer[2, 2] == pytest.approx(LENGTH**3 / (3 * bending), rel=0.01)
    assert answer[3, 2] == pytest.approx(LENGTH**2 / (2 * bending), rel=0.01)  # +Z force at +Y turns about +X
    assert answer[3, 3] == pytest.approx(LENGTH / bending, rel=0.01)
    assert answer[0, 0] == pytest.approx(answer[2, 2], rel=1e-6)
    assert answer[5, 0] == pytest.approx(-answer[3, 2], rel=1e-6)  # +X force at +Y turns about -Z
    # the pull acts on the thin rib at the end too, which bulges
    assert answer[1, 1] == pytest.approx(LENGTH / (YOUNG * AREA), rel=0.04)


def test_a_cantilever_sags_under_its_own_weight() -> None:
    """w L⁴/8EI, with the weight of the ribs in w."""
    part, end, tip = cantilever()
    moved = part.rail(end, tip).T @ part.displacements(part.own_weight[:, None])[:, 0]
    ribs = 5 * 2.0 * (SIDE - 2 * WALL) ** 2
    assert part.mass_t == pytest.approx(DENSITY * (AREA * LENGTH + ribs), rel=1e-9)
    np.testing.assert_allclose(part.centre_mm, 0.5 * tip, atol=1e-6)
    weight = GRAVITY * part.mass_t / LENGTH
    assert moved[2] == pytest.approx(-weight * LENGTH**4 / (8 * YOUNG * SECOND_MOMENT), rel=0.015)


def test_reciprocity_and_positive_energy() -> None:
    part, _, _ = cantilever()
    rail = Pads(2, SIDE / 2, 1, (900.0, 1500.0), 200.0, SIDE / 2 - WALL)
    answer = flexibility(part, rail, np.array([0.0, 1200.0, SIDE / 2]))
    size = np.sqrt(np.diag(answer))
    np.testing.assert_allclose(answer / np.outer(size, size), (answer / np.outer(size, size)).T, atol=1e-6)
    assert np.linalg.eigvalsh(answer / np.outer(size, size)).min() > 0.0


def unknowns_along(part: ElasticPart, axis: int) -> np.ndarray:
    """Return the unknowns that are displacements along an axis."""
    return part._basis.get_dofs(elements=True).all(f"u^{axis + 1}")


def test_a_rigid_motion_of_the_pads_moves_the_rail_alike() -> None:
    """The rail answers a rigid motion of all nodes with this motion: six independent mean values."""
    part, end, tip = cantilever()
    nodes = part._basis.doflocs
    shift, turn = np.array([1.0, -2.0, 0.5]), np.array([1e-3, 2e-3, -1e-3])
    moved = shift[:, None] + np.cross(turn, (nodes - tip[:, None]).T).T
    component = np.empty(part.unknowns, dtype=int)
    for axis in range(3):
        component[unknowns_along(part, axis)] = axis
    field = moved[component, np.arange(part.unknowns)]
    np.testing.assert_allclose(part.rail(end, tip).T @ field, np.concatenate((shift, turn)), atol=1e-9)


def test_finer_meshes_converge_from_the_stiff_side() -> None:
    sags = []
    for cells in (1, 2, 3):
        part, end, tip = cantilever(cells)
        sags.append(flexibility(part, end, tip)[2, 2])
    assert sags[0] <= sags[1] * (1 + 1e-9) <= sags[2] * (1 + 2e-9)
    assert sags[2] - sags[1] <= sags[1] - sags[0] + 1e-9 * sags[0]
    assert sags[2] == pytest.approx(sags[0], rel=0.01)


@pytest.mark.parametrize("length", [0.5, 60.0, 317.0, 700.0])
def test_each_pad_has_the_stated_stiffness_wherever_it_lies(length: float) -> None:
    """One pad within an element, one over ribs, one over the border of two elements: a rigid shift of 1 mm
    against one pad needs the force k."""
    half = SIDE / 2
    box = HollowBox(1, (-half, 0.0, -half), (half, LENGTH, half), WALL, 2.0, LENGTH / 4, 1)
    centres = (350.0, 1003.0, 1501.0)
    along, across = 2.0e4, 7.0e3
    for centre in centres:
        one = ElasticPads(Pads(2, -half, 1, (centre,), length, half - WALL), along, across)
        part = ElasticPart(box, Material(YOUNG, SHEAR_FREE, DENSITY), [])
        matrix = part._spring(one)
        forces = [np.isin(np.arange(part.unknowns), unknowns_along(part, axis)) for axis in range(3)]
        stiffness = [float(shift @ (matrix @ shift)) for shift in np.array(forces, dtype=float)]
        np.testing.assert_allclose(stiffness, (across, across, along), rtol=1e-9)
        measured = [pad.area for pad in part._pad_points(one.pads)]
        np.testing.assert_allclose(measured, [0.5 * length * 2 * WALL], rtol=1e-6)


def test_pads_beside_the_part_are_refused() -> None:
    part, _, _ = cantilever()
    for pads in (
        Pads(2, SIDE / 2, 1, (1000.0, LENGTH + 5.0), 100.0, SIDE / 2 - WALL),
        Pads(2, SIDE / 2, 1, (1000.0, LENGTH + 50.0), 100.0, SIDE / 2 - WALL),
        Pads(2, 3.0, 1, (1000.0,), 100.0, SIDE / 2 - WALL),
        Pads(2, SIDE / 2, 1, (1000.0,), 100.0, SIDE),
    ):
        with pytest.raises(InputError, match="do not lie on the part"):
            part.rail(pads, np.zeros(3))


def structure(**changed: Any) -> StructureSection:
    """Return the shipped structure on a grid of its corners, with coarse elements."""
    document = tomllib.loads(STRUCTURE.read_text(encoding="utf-8"))
    document["cells"] = 1
    document["grid"] = {"x_mm": [0.0, 4000.0, 2], "y_mm": [0.0, 1300.0, 2], "z_mm": [0.0, 1500.0, 2]}
    for part, keys in changed.items():
        document[part] |= keys
    return StructureSection.model_validate(document)


def test_a_soft_foot_turns_the_machine_as_statics_says() -> None:
    """Nearly rigid parts on a soft foot: sinking W/K, turning M/(K b²/12), both carried out to the tool point."""
    rigid = {"material": {"youngs_modulus_gpa": 1000.0, "density_kg_m3": 7850.0}}
    hard = {"pad_n_per_um": 1e6}
    section = structure(
        bed=rigid | {"support_n_per_um": 1e6},
        column=rigid | {"foot_n_per_um": 50.0, "shear_share": 1.0},
        ram=rigid | hard | {"head_kg": 400.0, "head_centre_mm": 100.0},
    )
    solved = solid_deflection(section)
    column, ram = section.column, section.ram
    hollow, bays = (ram.width_mm - 2 * ram.wall_mm) * (ram.height_mm - 2 * ram.wall_mm), 6
    volume = ram.length_mm * (ram.width_mm * ram.height_mm - hollow) + (bays + 1) * ram.rib_mm * hollow
    ram_kg = 7850e-9 * volume
    stiffness = 50e3 * column.depth_mm**2 / 12.0
    for j, y in enumerate((0.0, 1300.0)):
        for k, z in enumerate((0.0, 1500.0)):
            tip = 0.5 * column.depth_mm + ram.guide_front_mm + ram.overhang_mm + y
            parts = (
                (ram_kg, tip - 0.5 * ram.length_mm),
                (400.0, tip + 100.0),
                (column.carriage_kg, 0.5 * column.depth_mm + column.carriage_centre_mm),
            )
            turned = -9.80665 * sum(mass * arm for mass, arm in parts) / stiffness
            sunk = -9.80665 * sum(mass for mass, _ in parts) / 50e3
            expected = (0.0, -turned * (column.foot_mm + z), sunk + turned * tip)
            np.testing.assert_allclose(solved.parts["column"].values[0, j, k], expected, rtol=0.01, atol=2e-4)


def test_the_parts_add_up_and_the_machine_is_symmetric() -> None:
    solved = solid_deflection(structure())
    together = sum(grid.values for grid in solved.parts.values())
    np.testing.assert_allclose(solved.grid.values, together, atol=1e-12)
    ends = solved.grid.values[0], solved.grid.values[1]  # the supports lie symmetrically about the middle of X
    np.testing.assert_allclose(ends[0], ends[1] * (-1.0, 1.0, 1.0), atol=1e-7)
    assert (solved.grid.values[:, 1, :, 2] < solved.grid.values[:, 0, :, 2]).all()  # a ram further out hangs lower


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("from_mm = -900.0", "from_mm = -500.0", "the pads at supports_mm"),
        ("wheelbase_mm = 1100.0", "wheelbase_mm = 1900.0", "the trucks leave the bed"),
        ("height_mm = 2500.0", "height_mm = 2000.0", "the carriage leaves the column"),
        ("length_mm = 2350.0", "length_mm = 2000.0", "the ram leaves its guide"),
        ("wall_mm = 60.0", "wall_mm = 600.0", "leave no hollow"),
        ("rib_mm = 15.0", "rib_mm = 300.0", "do not fit into a pitch"),
        ("y_mm = [0.0, 1300.0, 15]", "y_mm = [1300.0, 0.0, 15]", "lower end, upper end"),
        ("foot_n_per_um = 150000.0", "foot_n_per_um = 0.0", "greater than or equal to 1"),
        ("head_kg = 150.0", "head_kgs = 150.0", "unknown key"),
    ],
)
def test_mistakes_in_a_structure_file(old: str, new: str, says: str) -> None:
    text = STRUCTURE.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(FormatError, match=says) as caught:
        parse_structure(text.replace(old, new), "s.toml")
    assert caught.value.where["file"] == "s.toml"
