import numpy as np
import pytest

from twin.errors import DataError, ModelError
from twin.machine.deflection import CASE_STUDY_NODES, cantilever_deflection
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import linear_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.volumetric import (
    QuadraticForm,
    align_rigidly,
    covering_grid,
    evaluation_grid,
    rigid_part,
    rms,
    volumetric_error,
)

RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 5)
TOOL = np.array([0.0, 250.0, 0.0])


def machine(seed, model=MODEL):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, model.size) * [1e-2 if p.unit == "mm" else 1e-5 for p in model.parameters]


def test_the_grid_has_its_ends_and_its_order():
    grid = evaluation_grid(RANGES)
    assert grid.shape == (24_000, 3)
    np.testing.assert_array_equal(grid[[0, 1, -1]], [[0, 0, 0], [0, 0, 1500 / 19], [4000, 1300, 1500]])


def test_rms_by_hand():
    assert rms(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])) == pytest.approx(np.sqrt(13.0))


def test_the_rigid_part_of_a_field_is_the_same_motion_elsewhere():
    points = evaluation_grid(RANGES, (5, 4, 3)) + TOOL
    elsewhere = np.array([[5000.0, -300.0, 20.0], [17.0, 900.0, 1200.0]])

    def motion(at):
        return np.array([1e-2, -2e-2, 5e-3]) + np.cross([3e-6, -7e-6, 1e-6], at)

    stretch = (points - points.mean(axis=0)) * [1e-6, 0.0, 0.0]
    np.testing.assert_allclose(rigid_part(points, motion(points) + stretch, elsewhere), motion(elsewhere), atol=1e-13)
    np.testing.assert_allclose(
        stretch - rigid_part(points, stretch, points), align_rigidly(points, stretch), atol=1e-15
    )


def test_a_rigid_motion_is_removed_and_nothing_else():
    points = evaluation_grid(RANGES, (5, 4, 3)) + TOOL
    rigid = np.array([1e-2, -2e-2, 5e-3]) + np.cross([3e-6, -7e-6, 1e-6], points)
    assert rms(align_rigidly(points, rigid)) < 1e-15
    stretch = (points - points.mean(axis=0)) * [1e-6, 0.0, 0.0]  # symmetric: no rigid part
    np.testing.assert_allclose(align_rigidly(points, stretch + rigid), stretch, atol=1e-14)


def test_alignment_against_plain_least_squares():
    rng = np.random.default_rng(2)
    points, field = rng.uniform(0.0, 1000.0, (30, 3)), rng.normal(0.0, 1e-2, (30, 3))
    columns = [np.tile(unit, (30, 1)) for unit in np.eye(3)] + [np.cross(unit, points) for unit in np.eye(3)]
    design = np.stack(columns, axis=-1).reshape(-1, 6)
    solution, *_ = np.linalg.lstsq(design, field.reshape(-1), rcond=None)
    expected = field - (design @ solution).reshape(-1, 3)
    np.testing.assert_allclose(align_rigidly(points, field), expected, atol=1e-13)


def test_few_points_are_aligned_as_far_as_they_determine_it():
    assert rms(align_rigidly([[1.0, 2.0, 3.0]], [[0.1, 0.2, 0.3]])) < 1e-15
    in_line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    turned = np.cross([5e-3, 1e-3, 2e-3], in_line)
    assert rms(align_rigidly(in_line, turned)) < 1e-15


def test_the_form_is_the_grid_to_nine_digits_raw_and_aligned():
    grid = evaluation_grid(RANGES, (12, 7, 6))
    form = QuadraticForm.build(MODEL, grid, TOOL)
    for seed in range(5):
        errors = machine(seed)
        direct = volumetric_error(grid + TOOL, linear_deviation(MODEL, grid, TOOL, errors))
        value = form.value(errors)
        assert value.raw_mm == pytest.approx(direct.raw_mm, rel=1e-9)
        assert value.aligned_mm == pytest.approx(direct.aligned_mm, rel=1e-9)
        assert value.aligned_um < value.raw_um


def test_the_form_with_a_fixed_field():
    grid = evaluation_grid(RANGES, (10, 6, 5))
    field = 5e-3 * np.random.default_rng(3).normal(size=grid.shape)
    form = QuadraticForm.build(MODEL, grid, TOOL)
    with_field = form.with_field(field)
    errors = np.stack([machine(seed) for seed in range(4)])
    raw, aligned = with_field.values(errors)
    for k, vector in enumerate(errors):
        direct = volumetric_error(grid + TOOL, linear_deviation(MODEL, grid, TOOL, vector) + field)
        assert (raw[k], aligned[k]) == pytest.approx((direct.raw_mm, direct.aligned_mm), rel=1e-9)
        assert form.value(vector, field).raw_mm == pytest.approx(direct.raw_mm, rel=1e-9)


def test_ve_and_vce_of_the_family_are_those_of_the_whole_grid():
    """Sum 60×20×20 points one by one, with the deflection that no model represents; VCE is the form of truth minus
    model.
    """
    family = family_from_amplitudes(MODEL, {"positioning_um": 8.0, "straightness_um": 5.0, "rotation_urad": 4.6})
    rng = np.random.default_rng(8)
    truth, model = family.draw(rng, 3), family.draw(rng, 3)
    grid = evaluation_grid(RANGES)
    deflection = cantilever_deflection(*CASE_STUDY_NODES).at(grid)
    form = QuadraticForm.build(MODEL, grid, TOOL).with_field(deflection)
    for left in (truth, truth - model, truth - 0.99 * truth):
        found = np.stack(form.values(left), axis=1)
        for machine_left, (raw, aligned) in zip(left, found, strict=True):
            direct = volumetric_error(grid + TOOL, linear_deviation(MODEL, grid, TOOL, machine_left) + deflection)
            assert raw == pytest.approx(direct.raw_mm, rel=1e-9)
            assert aligned == pytest.approx(direct.aligned_mm, rel=1e-9)


def test_the_points_of_the_form_need_no_order():
    grid = evaluation_grid(RANGES, (11, 10, 9))
    shuffled = np.random.default_rng(5).permutation(grid)
    one, other = (QuadraticForm.build(MODEL, points, TOOL) for points in (grid, shuffled))
    largest = np.abs(other.raw).max()
    np.testing.assert_allclose(one.raw, other.raw, rtol=0, atol=1e-12 * largest)
    np.testing.assert_allclose(one.aligned, other.aligned, rtol=0, atol=1e-12 * largest)


def test_a_grid_has_uneven_nodes_where_somebody_gives_them():
    x, y, z = [0.0, 100.0, 4000.0], [0.0, 1300.0], [0.0, 700.0, 800.0, 1500.0]
    grid = covering_grid(RANGES, (x, y, z))
    assert grid.shape == (24, 3)
    np.testing.assert_array_equal(grid[5], [0.0, 1300.0, 700.0])


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        (([0.0, 3900.0], [0.0, 1300.0], [0.0, 1500.0]), "from 0 to 3900 mm does not cover the workspace .axis X"),
        (([0.0, 4000.0], [1.0, 1300.0], [0.0, 1500.0]), "from 1 to 1300 mm does not cover the workspace .axis Y"),
        (([0.0, 4000.0], [0.0, 1300.0], [750.0]), "1 point does not cover the workspace .axis Z"),
        (([0.0, 4000.0], [], [0.0, 1500.0]), "no points does not cover the workspace .axis Y"),
        (([0.0, 4000.0], [0.0, 1300.0], [1500.0, 0.0]), "do not ascend does not cover the workspace .axis Z"),
        (([0.0, np.nan, 4000.0], [0.0, 1300.0], [0.0, 1500.0]), "axis X"),
    ],
)
def test_a_grid_that_does_not_cover_the_workspace(nodes, words):
    with pytest.raises(ModelError, match=words):
        covering_grid(RANGES, nodes)


def test_the_expected_value_is_the_mean_over_draws():
    grid = evaluation_grid(RANGES, (8, 5, 4))
    form = QuadraticForm.build(MODEL, grid, TOOL).with_field(np.full(grid.shape, 2e-3))
    rng = np.random.default_rng(4)
    root = rng.normal(size=(MODEL.size, MODEL.size)) * [1e-3 if p.unit == "mm" else 1e-6 for p in MODEL.parameters]
    covariance = root.T @ root
    raw, aligned = form.values(rng.multivariate_normal(np.zeros(MODEL.size), covariance, 20_000))
    expected = form.expected(covariance)
    assert expected.raw_mm == pytest.approx(np.sqrt(np.mean(raw**2)), rel=0.02)
    assert expected.aligned_mm == pytest.approx(np.sqrt(np.mean(aligned**2)), rel=0.02)


def test_wrong_shapes():
    form = QuadraticForm.build(MODEL, evaluation_grid(RANGES, (2, 2, 2)), TOOL)
    with pytest.raises(ModelError, match="expected"):
        form.values(np.zeros((2, 3)))
    with pytest.raises(DataError, match="5 points, the grid 8"):
        form.with_field(np.zeros((5, 3)))
