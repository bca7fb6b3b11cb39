"""The page on finite elements states what the program computes, and the beams of the textbook give its two terms."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from agent.finite_elements.machine_structure import solid_deflection
from agent.model_files import load_machine
from twin.finite_elements.cross_effect_share import CrossEffectShare, cross_effect_share
from twin.finite_elements.structure_file import StructureSection, parse_structure
from twin.finite_elements.tool_displacements import middle_of, relative_to
from twin.formats.deflection_file import parse_deflection
from twin.machine.machine_description import MachineDescription

ROOT = Path(__file__).parents[3]
MACHINES = ROOT / "config" / "machines"
STRUCTURE = ROOT / "config" / "structures" / "case-study.toml"
PAGE = (ROOT / "docs" / "explanation" / "finite-elements.md").read_text(encoding="utf-8")
SOLID = MACHINES / "case-study-solid-deflection.csv"


@pytest.fixture(scope="module")
def machine() -> MachineDescription:
    return load_machine(MACHINES / "case-study.toml")


@pytest.fixture(scope="module")
def structure() -> StructureSection:
    return parse_structure(STRUCTURE.read_text(encoding="utf-8"), STRUCTURE.name)


def rows() -> dict[str, list[float]]:
    found = re.findall(r"^\| ([^|]+) \| (-?[\d.]+) \| (-?[\d.]+) \|$", PAGE, re.MULTILINE)
    return {name: [float(first), float(second)] for name, first, second in found}


def column_of(share: CrossEffectShare) -> list[float]:
    rms = [share.raw_um, share.aligned_um, share.without_series_um, share.rest_um]
    return [*share.largest_um, *rms, *share.terms.values()]


def test_the_table_is_what_the_command_prints(machine: MachineDescription) -> None:
    grids = [parse_deflection(file.read_text(), file.name) for file in (MACHINES / "case-study-deflection.csv", SOLID)]
    columns = [column_of(cross_effect_share(grid, machine)) for grid in grids]
    stated = [values for name, values in rows().items() if name.startswith(("largest", "rms", "CROSS"))]
    np.testing.assert_allclose(np.array(stated).T, columns, atol=0.0051)


def test_the_error_of_the_mesh_is_that_of_its_limit() -> None:
    """The limit a of a + b/nᵖ, and how far below it the largest displacements of the shipped grid are."""
    found = re.findall(r"^\| along ([YZ]) \|" + r" ([\d.]+) \|" * 5 + "$", PAGE, re.MULTILINE)
    said = re.search(r"are about (\d) % and (\d) % too small", PAGE)
    assert said is not None
    assert len(found) == 2
    for (axis, *numbers), percent in zip(found, said.groups(), strict=True):
        _, two, three, four, limit = map(float, numbers)
        assert two == rows()[f"largest displacement along {axis}"][1]
        order = brentq(lambda p, a=two, b=three, c=four: (b - a) * (3**-p - 4**-p) - (c - b) * (2**-p - 3**-p), 0.5, 4)
        expected = four + (four - three) / (3**-order - 4**-order) * 4**-order
        assert limit == pytest.approx(expected, abs=0.15)  # the order is known to the rounding of the differences
        assert int(percent) == round(100 * (1 - two / expected))


def test_the_column_of_the_textbook(machine: MachineDescription, structure: StructureSection) -> None:
    """b2 = P Ly Lz²/2EI, c1 = -P Ly Lz/EI and, for a foot that does not turn, b1 = P Ly h Lz/EI."""
    column, ram = structure.column, structure.ram
    inner = (column.width_mm - 2 * column.wall_mm) * (column.depth_mm - 2 * column.wall_mm) ** 3
    stiffness = 210e3 * (column.width_mm * column.depth_mm**3 - inner) / 12.0
    hollow = (ram.width_mm - 2 * ram.wall_mm) * (ram.height_mm - 2 * ram.wall_mm)
    volume = ram.length_mm * (ram.width_mm * ram.height_mm - hollow) + 7 * ram.rib_mm * hollow
    load = 9.80665 * (7850e-9 * volume + ram.head_kg)
    turned = load * 1300.0 * 1500.0 / stiffness
    expected = {"b2": 1e3 * turned * 1500.0 / 2.0, "c1": -1e6 * turned, "b1": 1e3 * turned * column.foot_mm}
    found = re.findall(r"^\| (b1|b2|c1) \| [^|]+ \| (-?[\d.]+) \| (-?[\d.]+) \|$", PAGE, re.MULTILINE)
    stated = {name: (float(closed), float(solid)) for name, closed, solid in found}
    assert set(stated) == {"b1", "b2", "c1"}
    for name, (closed, _) in stated.items():
        assert closed == pytest.approx(expected[name], abs=0.0051), name
        assert stated[name][1] == rows()[f"CROSS[{name}] / {'µrad' if name == 'c1' else 'µm'}"][1]
    solid = cross_effect_share(parse_deflection(SOLID.read_text(), SOLID.name), machine).terms
    assert solid["CROSS[b2]"] == pytest.approx(expected["b2"], rel=0.05)
    assert solid["CROSS[c1]"] == pytest.approx(expected["c1"], rel=0.05)


@pytest.mark.long
def test_the_shipped_grid_is_that_of_the_solid_model(structure: StructureSection) -> None:
    solved = solid_deflection(structure).grid
    shipped = parse_deflection(SOLID.read_text(), SOLID.name)
    difference = relative_to(solved, middle_of(solved)).values - shipped.values
    assert np.abs(difference).max() < 1e-6
