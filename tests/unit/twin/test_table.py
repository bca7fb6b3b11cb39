"""Compensation tables: signs, anchors, interpolation, the measured region."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_set import RANGES, TOOL, case_study
from scipy.interpolate import RegularGridInterpolator

from twin.compensation.table import CompensationTable, MeasuredRegion, build_table, regular_nodes
from twin.errors import DataError, ModelError
from twin.machine.anchor import Anchor
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms, volumetric_error

MODEL, FAMILY = case_study(5)
E = FAMILY.draw(np.random.default_rng(31), 1)[0]
NODES = regular_nodes(RANGES, (100.0, 100.0, 100.0))
EVERYWHERE = evaluation_grid(RANGES, (3, 3, 3))
GRID = evaluation_grid(RANGES, (23, 13, 11))


def table(anchor: Anchor | None = None, parameters: np.ndarray = E) -> CompensationTable:
    return build_table(MODEL, parameters, NODES, TOOL, anchor or Anchor(np.zeros(3)), EVERYWHERE)


def reached(one: CompensationTable, points: np.ndarray) -> np.ndarray:
    """Return the deviation (n, 3) from the nominal point when the controller adds the table to the command."""
    command = points + one.at(points)
    return command - points + exact_deviation(MODEL, command, TOOL, E)


def test_the_compensated_machine_is_better_down_to_the_interpolation() -> None:
    bare = volumetric_error(GRID + TOOL, exact_deviation(MODEL, GRID, TOOL, E)).aligned_um
    assert bare > 5.0
    assert volumetric_error(GRID + TOOL, reached(table(), GRID)).aligned_um < 0.03 * bare


def test_at_the_nodes_only_a_rigid_motion_is_left() -> None:
    points = np.stack(np.meshgrid(*NODES, indexing="ij"), axis=-1).reshape(-1, 3)
    assert rms(align_rigidly(points + TOOL, reached(table(), points))) < 1e-7


def test_a_long_x_scale_is_corrected_with_the_opposite_sign() -> None:
    """Check a machine that goes 8 µm too far at the end of X: 8 µm less must be commanded."""
    parameters = np.zeros(MODEL.size)
    parameters[MODEL.index("EXX[1]")] = 4e-3  # P1 runs from -1 to 1: -4 µm at the start, +4 µm at the end
    found = table(parameters=parameters)
    assert found.corrections[-1, 5, 5] == pytest.approx([-8e-3, 0.0, 0.0], abs=1e-7)
    assert found.corrections[0, 5, 5] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_the_six_constraints_hold() -> None:
    point = np.array([1000.0, 400.0, 700.0])
    one = table(Anchor(point))
    assert one.at(point)[0] == pytest.approx(np.zeros(3), abs=1e-9)
    x = np.linspace(0.0, 4000.0, 41)
    along_x = one.at(np.column_stack((x, np.full(41, 400.0), np.full(41, 700.0))))
    assert np.polyfit(x, along_x[:, 1:], 1)[0] == pytest.approx([0.0, 0.0], abs=1e-8)
    y = np.linspace(0.0, 1300.0, 41)
    along_y = one.at(np.column_stack((np.full(41, 1000.0), y, np.full(41, 700.0))))
    assert np.polyfit(y, along_y[:, 2], 1)[0] == pytest.approx(0.0, abs=2e-7)  # interpolation: 0.2 µrad


def test_another_anchor_is_another_rigid_motion() -> None:
    points = np.stack(np.meshgrid(*NODES, indexing="ij"), axis=-1).reshape(-1, 3)
    one, other = table(), table(Anchor(np.array([2000.0, 600.0, 800.0]), "Z", "X"))
    difference = (one.corrections - other.corrections).reshape(-1, 3)
    assert rms(difference) > 1e-3
    assert np.abs(align_rigidly(points + TOOL, difference)).max() < 1e-5


def test_trilinear_reading_agrees_with_scipy_and_is_held_beyond_the_border() -> None:
    one = table()
    reference = RegularGridInterpolator(NODES, one.corrections)
    low, high = np.array(RANGES).T
    points = np.random.default_rng(1).uniform(low, high, (500, 3))
    assert one.at(points) == pytest.approx(reference(points), abs=1e-12)
    assert one.at([[-50.0, 1400.0, 700.0]])[0] == pytest.approx(one.at([[0.0, 1300.0, 700.0]])[0], abs=1e-15)


class TestMeasuredRegion:
    def test_inside_and_outside_of_a_hull(self) -> None:
        corners = np.array([[0, 0, 0], [1000, 0, 0], [0, 1000, 0], [0, 0, 1000]], dtype=float)
        region = MeasuredRegion.around(corners, margin_mm=10.0)
        inside = region.contains(np.array([[100.0, 100, 100], [-9, 50, 50], [-11, 50, 50], [500, 500, 500]]))
        assert inside.tolist() == [True, True, False, False]

    def test_points_in_one_plane_give_their_box(self) -> None:
        flat = np.array([[0, 0, 5], [1000, 0, 5], [0, 1000, 5], [800, 700, 5]], dtype=float)
        region = MeasuredRegion.around(flat, margin_mm=10.0)
        inside = region.contains(np.array([[990.0, 990, 5], [500, 500, 14], [500, 500, 16], [1011, 0, 5]]))
        assert inside.tolist() == [True, True, False, False]

    def test_nodes_that_were_not_measured_are_marked(self) -> None:
        half = EVERYWHERE * [0.5, 1.0, 1.0]
        one = build_table(MODEL, E, NODES, TOOL, Anchor(np.zeros(3)), MeasuredRegion.around(half, 0.0))
        assert not one.extrapolated[:21].any()
        assert one.extrapolated[21:].all()


def test_nodes_reach_both_ends_and_are_no_farther_apart_than_asked() -> None:
    x, y, z = regular_nodes(RANGES, (300.0, 100.0, 1500.0))
    assert (x[0], x[-1], len(x), len(y), len(z)) == (0.0, 4000.0, 15, 14, 2)
    with pytest.raises(ModelError, match="step"):
        regular_nodes(RANGES, (100.0, 0.0, 100.0))


@pytest.mark.parametrize(("primary", "secondary"), [("X", "X"), ("X", "A"), ("U", "Y")])
def test_an_anchor_needs_two_axes(primary: str, secondary: str) -> None:
    with pytest.raises(ModelError, match="two different axes"):
        Anchor(np.zeros(3), primary, secondary)


def test_an_anchor_outside_the_table_is_refused() -> None:
    with pytest.raises(ModelError, match="outside the table"):
        table(Anchor(np.array([0.0, -1.0, 0.0])))


@pytest.mark.parametrize(
    "wrong",
    [
        {"x": np.array([0.0, 0.0])},
        {"x": np.array([0.0])},
        {"corrections": np.zeros((2, 2, 2, 2))},
        {"corrections": np.full((2, 2, 2, 3), np.nan)},
    ],
)
def test_a_table_that_cannot_be(wrong: dict) -> None:
    two = np.array([0.0, 1.0])
    good = CompensationTable(
        two, two, two, np.zeros((2, 2, 2, 3)), TOOL, Anchor(np.zeros(3)), np.zeros((2, 2, 2), dtype=bool)
    )
    with pytest.raises(DataError):
        replace(good, **wrong)
