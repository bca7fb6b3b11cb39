"""Frames, units, datum and gaps of imported results, against transformations that are written out here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin.errors import DataError
from twin.finite_elements.axis_frame import IDENTITY, parse_frame
from twin.finite_elements.cross_effect_share import cross_effect_share
from twin.finite_elements.tool_displacements import (
    ToolDisplacements,
    assemble_grid,
    check_covers,
    check_size,
    middle_of,
    node_points,
    relative_to,
    resampled,
    tool_displacements,
    without_rigid_motion,
)
from twin.formats.machine_file import parse_machine
from twin.machine.deflection import DeflectionGrid
from twin.machine.machine_description import MachineDescription

NODES = (np.array([0.0, 10.0, 30.0]), np.linspace(-5.0, 5.0, 5), np.linspace(0.0, 8.0, 6))


@pytest.fixture(scope="module")
def case_machine() -> MachineDescription:
    file = Path(__file__).parents[3] / "config" / "machines" / "case-study.toml"
    return parse_machine(file.read_text(), file.name, lambda name: (file.parent / name).read_text())


def points() -> np.ndarray:
    return np.stack(np.meshgrid(*NODES, indexing="ij"), axis=-1).reshape(-1, 3)


def field(at: np.ndarray) -> np.ndarray:
    x, y, z = at.T
    return 1e-3 * np.stack((x * y / 30.0, y**3 / 25.0 + z, z**2 * y / 10.0 - x), axis=1)


def found(at: np.ndarray, values: np.ndarray | None = None) -> ToolDisplacements:
    labels = tuple(f"row {number}" for number in range(2, len(at) + 2))
    return ToolDisplacements(at, field(at) if values is None else values, labels)


def test_a_frame_turns_displacements_and_rotations() -> None:
    """A model whose y points up and whose z points against the machine's Y."""
    frame = parse_frame("X=+x, Y=-z, Z=y")
    np.testing.assert_array_equal(frame.vectors(np.array([[1.0, 2.0, 3.0]])), [[1.0, -3.0, 2.0]])
    np.testing.assert_array_equal(frame.rotations(np.array([[1.0, 2.0, 3.0]])), [[1.0, -3.0, 2.0]])


def test_a_mirrored_frame_reverses_rotations_in_addition() -> None:
    """u = r × p holds in both frames only if the rotation is a pseudovector."""
    frame = parse_frame("X=-x,Y=y,Z=z", mirrored=True)
    rotation, arm = np.array([[1e-5, 2e-5, -3e-5]]), np.array([[100.0, -20.0, 30.0]])
    moved = np.cross(rotation, arm)
    np.testing.assert_allclose(
        np.cross(frame.rotations(rotation), frame.vectors(arm)), frame.vectors(moved), atol=1e-18
    )


@pytest.mark.parametrize(
    ("text", "mirrored", "says"),
    [
        ("X=x,Y=y", False, "Z is missing"),
        ("X=x,Y=y,X=z", False, "X is stated twice"),
        ("X=x,Y=y,Z=y", False, "z is used by no"),
        ("X=x,Y=z,Z=y", False, "left-handed"),
        ("X=x,Y=y,Z=z", True, "right-handed"),
        ("x,y,z", False, "not an axis"),
    ],
)
def test_wrong_frames(text: str, mirrored: bool, says: str) -> None:
    with pytest.raises(DataError, match=says):
        parse_frame(text, mirrored)


def test_units_and_the_lever_arm_of_the_tool() -> None:
    rotations = np.array([[1e-5, 0.0, 0.0], [0.0, 0.0, 2e-5]])
    moved = tool_displacements(
        np.zeros((2, 3)), np.full((2, 3), 1e-6), rotations, ("a", "b"), "m", IDENTITY, np.array([0.0, 100.0, 0.0])
    ).displacements_mm
    np.testing.assert_allclose(moved, [[1e-3, 1e-3, 2e-3], [-1e-3, 1e-3, 1e-3]], rtol=1e-12)


def test_offsets_need_rotations_in_rad() -> None:
    offset, one = np.array([0.0, 1.0, 0.0]), np.zeros((1, 3))
    with pytest.raises(DataError, match="contain no rotations"):
        tool_displacements(one, one, None, ("a",), "mm", IDENTITY, offset)
    with pytest.raises(DataError, match="no deflection"):
        tool_displacements(one, one, one + 0.5, ("row 2",), "mm", IDENTITY, offset)


def test_a_wrong_unit_is_noticed_and_the_right_one_proposed() -> None:
    metres_as_mm = found(points(), 1e-6 * field(points()))
    with pytest.raises(DataError, match="In m they would be plausible"):
        check_size(metres_as_mm, "mm")
    check_size(found(points()), "mm")
    shifted = found(points(), field(points()) + 50.0)  # a model that hangs somewhere
    check_size(shifted, "mm")


def test_a_grid_in_any_order() -> None:
    at = points()[np.random.default_rng(1).permutation(len(points()))]
    grid = assemble_grid(found(at)).grid
    np.testing.assert_allclose(grid.at(at), field(at), atol=1e-15)


def test_missing_positions_are_named_and_filled_between_others() -> None:
    at = points()
    gap = (at == [10.0, 0.0, NODES[2][2]]).all(axis=1)
    assert gap.sum() == 1
    with pytest.raises(DataError, match=r"1 of 90 positions .* X 10 Y 0 Z 3.2"):
        assemble_grid(found(at[~gap]))
    filled = assemble_grid(found(at[~gap]), fill=True)
    np.testing.assert_array_equal(filled.filled_mm, at[gap])
    # along Y and Z a cubic and a parabola are met exactly, along X (three nodes) a line is
    np.testing.assert_allclose(filled.grid.at(at[gap]), field(at[gap]), atol=1e-12)


def test_corners_and_too_many_gaps_are_not_filled() -> None:
    at = points()
    corner = (at == [0.0, -5.0, 0.0]).all(axis=1)
    with pytest.raises(DataError, match="does not lie between others"):
        assemble_grid(found(at[~corner]), fill=True)
    with pytest.raises(DataError, match="At most 20 %"):
        assemble_grid(found(at[np.random.default_rng(2).permutation(90)[:60]]), fill=True)
    scattered = np.random.default_rng(3).random((2000, 3))
    with pytest.raises(DataError, match=r"of 79\d{8} positions"):
        assemble_grid(found(scattered), fill=True)


def test_a_position_given_twice() -> None:
    at = np.concatenate((points(), points()[4:5] + 1e-9))
    with pytest.raises(DataError, match="row 92 is that of row 6 too"):
        assemble_grid(found(at))


def test_a_rigid_motion_disappears_with_the_datum() -> None:
    at = points()
    shift, turn = np.array([0.3, -0.2, 5.0]), np.array([1e-4, -2e-4, 3e-4])
    moved = field(at) + shift + np.cross(turn, at)
    plain = without_rigid_motion(assemble_grid(found(at)).grid)
    again = without_rigid_motion(assemble_grid(found(at, moved)).grid)
    np.testing.assert_allclose(again.values, plain.values, atol=1e-12)
    grid = relative_to(again, middle_of(again))
    np.testing.assert_allclose(grid.at(middle_of(grid)), 0.0, atol=1e-15)


def test_resampling_follows_curvature() -> None:
    fine = resampled(assemble_grid(found(points())).grid, (5, 9, 21))
    assert fine.values.shape == (5, 9, 21, 3)
    np.testing.assert_allclose(fine.values.reshape(-1, 3), field(node_points(fine)), atol=1e-12)


def test_a_grid_that_does_not_reach_the_end_of_the_travel() -> None:
    grid = assemble_grid(found(points())).grid
    check_covers(grid, ((0.0, 30.0), (-5.0, 5.0), (0.0, 8.0)), "m")
    with pytest.raises(DataError, match="axis Y"):
        check_covers(grid, ((0.0, 30.0), (-5.0, 6.0), (0.0, 8.0)), "m")


def test_the_cross_effect_of_two_beams_is_found(case_machine: MachineDescription) -> None:
    """A column alone bends by M (h + z)²/2EI and M (h + z)/EI with M = P y: b1 = P Ly h Lz/EI, b2 = P Ly Lz²/2EI."""
    load_over_stiffness, foot = 1e-12, 400.0
    x, y, z = (np.linspace(low, high, 23) for low, high in case_machine.model.ranges_mm)
    _, y3, z3 = np.meshgrid(x, y, z, indexing="ij")
    height = foot + z3
    lean, nod = (load_over_stiffness * y3 * part for part in (height**2 / 2.0, height))
    grid = DeflectionGrid(x, y, z, np.stack((np.zeros_like(lean), lean, -nod * y3), axis=-1))
    share = cross_effect_share(grid, case_machine)
    (y_low, y_high), (z_low, z_high) = case_machine.model.ranges_mm[1:]
    whole = 1e3 * load_over_stiffness * (y_high - y_low) * (z_high - z_low)
    assert share.terms["CROSS[b2]"] == pytest.approx(whole * (z_high - z_low) / 2.0, rel=0.02)
    assert share.terms["CROSS[b1]"] == pytest.approx(whole * foot, rel=0.02)
    assert share.terms["CROSS[c1]"] == pytest.approx(-1e3 * whole, rel=0.02)  # µrad
    assert share.rest_um < 0.02 * share.without_series_um
