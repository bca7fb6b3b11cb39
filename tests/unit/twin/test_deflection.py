import math

import numpy as np
import pytest

from twin.errors import DataError, ModelError
from twin.machine.deflection import CASE_STUDY_NODES, CantileverStructure, DeflectionGrid, cantilever_deflection


def trilinear_grid():
    """Return values of a field that trilinear interpolation must reproduce exactly."""
    nodes = np.array([0.0, 3.0, 4.0]), np.array([-1.0, 1.0]), np.array([10.0, 20.0, 50.0, 60.0])
    return DeflectionGrid(*nodes, field(*np.meshgrid(*nodes, indexing="ij")))


def field(x, y, z):
    return np.stack((x * y * z, 2.0 * x - y + 0.5, z * y - x), axis=-1)


def test_trilinear_fields_are_met_everywhere():
    grid = trilinear_grid()
    points = np.random.default_rng(1).uniform([0.0, -1.0, 10.0], [4.0, 1.0, 60.0], (200, 3))
    np.testing.assert_allclose(grid.at(points), field(*points.T), atol=1e-12)


def test_nodes_and_corners_are_met_exactly():
    grid = cantilever_deflection(*CASE_STUDY_NODES)
    for i, j, k in ((0, 0, 0), (8, 14, 12), (3, 7, 5), (8, 0, 12)):
        np.testing.assert_array_equal(grid.at([grid.x[i], grid.y[j], grid.z[k]])[0], grid.values[i, j, k])


def test_outside_is_an_error_that_names_point_and_axis():
    grid = trilinear_grid()
    with pytest.raises(ModelError, match=r"\(1.000, 0.000, 60.010\) lies outside") as caught:
        grid.at([[1.0, 0.0, 30.0], [1.0, 0.0, 60.01]])
    assert (caught.value.where["axis"], caught.value.where["row"]) == ("Z", "1")
    with pytest.raises(DataError, match="not finite"):
        grid.at([math.nan, 0.0, 30.0])


def test_the_last_digits_of_a_border_are_no_excuse():
    grid = trilinear_grid()
    np.testing.assert_array_equal(grid.at([4.0 + 1e-9, 1.0, 60.0]), grid.at([4.0, 1.0, 60.0]))


def test_wrong_grids():
    x = np.array([0.0, 1.0])
    values = np.zeros((2, 2, 2, 3))
    for nodes, content, says in (
        ((x, x[::-1], x), values, "ascending"),
        ((x, x, x[:1]), values, "two nodes"),
        ((x, x, x), values[:1], "shape"),
        ((x, x, x), values + np.nan, "finite"),
    ):
        with pytest.raises(ModelError, match=says):
            DeflectionGrid(*nodes, content)


def test_a_ram_alone_sags_like_the_beam_of_the_textbook():
    stiff, nothing = 1e30, 0.0
    ram = CantileverStructure(
        ram_load_n_per_mm=0.0,
        head_weight_n=1000.0,
        overhang_mm=200.0,
        ram_stiffness_n_mm2=1e14,
        ram_joint_rad_per_n_mm=nothing,
        column_stiffness_n_mm2=stiff,
        foot_joint_rad_per_n_mm=nothing,
        bed_sag_mm=nothing,
        bed_roll_rad_per_n_mm=nothing,
        column_rail_wave_mm=nothing,
    )
    grid = cantilever_deflection(*CASE_STUDY_NODES, structure=ram)
    tip, root = (-1000.0 * length**3 / (3.0 * 1e14) for length in (1500.0, 200.0))
    fall = grid.at([0.0, 1300.0, 0.0]) - grid.at([0.0, 0.0, 0.0])
    np.testing.assert_allclose(fall[0], (0.0, 0.0, tip - root), atol=1e-12)


def test_the_column_bends_as_the_cross_effect_says():
    """Check that with only a compliant column uy is moment times height squared over 2EI."""
    column = CantileverStructure(
        ram_load_n_per_mm=0.0,
        head_weight_n=1000.0,
        overhang_mm=100.0,
        column_foot_mm=500.0,
        column_stiffness_n_mm2=1e15,
        ram_stiffness_n_mm2=1e30,
        ram_joint_rad_per_n_mm=0.0,
        foot_joint_rad_per_n_mm=0.0,
        bed_sag_mm=0.0,
        bed_roll_rad_per_n_mm=0.0,
        column_rail_wave_mm=0.0,
    )
    grid = cantilever_deflection(*CASE_STUDY_NODES, structure=column)
    lean = grid.at([0.0, 1300.0, 1500.0])[0, 1] - grid.at([0.0, 1300.0, 0.0])[0, 1]
    assert lean == pytest.approx(1000.0 * 1400.0 * (2000.0**2 - 500.0**2) / (2.0 * 1e15), rel=1e-9)


def test_the_case_study_is_zero_in_the_middle_and_sags_outwards():
    grid = cantilever_deflection(*CASE_STUDY_NODES)
    np.testing.assert_allclose(grid.at([2000.0, 650.0, 750.0]), 0.0, atol=1e-15)
    assert grid.at([2000.0, 1300.0, 1500.0])[0, 2] < grid.at([2000.0, 0.0, 1500.0])[0, 2]
    assert grid.covers(((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0)))
    assert not grid.covers(((0.0, 4000.0), (0.0, 1300.0), (-1.0, 1500.0)))
