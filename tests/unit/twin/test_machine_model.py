import itertools

import numpy as np
import plain_machine
import pytest

from twin.errors import DataError
from twin.machine.error_model import CROSS_TERMS, ErrorModel
from twin.machine.forward_model import deviation_basis, exact_deviation, linear_deviation
from twin.machine.kinematic_chain import parse_chain

CASE_STUDY = "tool-Y-Z-X-bed-workpiece"
RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
PROBE = np.array([0.0, 250.0, 0.0])
ALL_CHAINS = [
    "-".join(("tool", *order[:bed], "bed", *order[bed:], "workpiece"))
    for order in itertools.permutations("XYZ")
    for bed in range(4)
]


def model_of(chain=CASE_STUDY, order=5, terms=CROSS_TERMS, ranges=RANGES):
    return ErrorModel.uniform(parse_chain(chain), ranges, order, terms)


def random_errors(model, rng, size_um=20.0, size_urad=20.0):
    sizes = [1e-3 * size_um if p.unit == "mm" else 1e-6 * size_urad for p in model.parameters]
    return rng.uniform(-1.0, 1.0, model.size) * sizes


def one(model, name, value=1e-6):
    vector = np.zeros(model.size)
    vector[model.index(name)] = value
    return vector


@pytest.mark.parametrize("chain", ALL_CHAINS)
def test_exact_is_the_plain_product_of_matrices(chain):
    rng = np.random.default_rng(5)
    ranges = ((-500.0, 3500.0), (100.0, 1400.0), (-1500.0, 0.0))
    model = model_of(chain, ranges=ranges)
    low, high = np.array(ranges).T
    points = rng.uniform(low, high, (6, 3))
    tool = np.array([30.0, 250.0, -120.0])
    errors = random_errors(model, rng)
    expected = plain_machine.deviations(chain, ranges, points, tool, dict(zip(model.names, errors, strict=True)))
    assert np.abs(exact_deviation(model, points, tool, errors) - expected).max() < 5e-12


def test_exact_holds_for_errors_of_milliradians_where_the_short_series_of_sines_end():
    rng = np.random.default_rng(6)
    model = model_of("tool-Z-bed-Y-X-workpiece")
    points = rng.uniform(0.0, [4000.0, 1300.0, 1500.0], (5, 3))
    errors = random_errors(model, rng, 2000.0, 30_000.0)
    expected = plain_machine.deviations(
        "tool-Z-bed-Y-X-workpiece", RANGES, points, PROBE, dict(zip(model.names, errors, strict=True))
    )
    assert np.abs(expected).max() > 10.0
    assert np.abs(exact_deviation(model, points, PROBE, errors) - expected).max() < 1e-11


@pytest.mark.parametrize("count", [0, 1, 2, 5999, 6000, 6001, 13001])
def test_chunks_leave_no_seam(count):
    rng = np.random.default_rng(7)
    model = model_of()
    points = rng.uniform(0.0, [4000.0, 1300.0, 1500.0], (count, 3))
    errors = random_errors(model, rng)
    together = exact_deviation(model, points, PROBE, errors)
    assert together.shape == (count, 3)
    for row in {0, count // 2, count - 1, min(6000, count - 1)} if count else ():
        np.testing.assert_allclose(
            together[row], exact_deviation(model, points[row], PROBE, errors)[0], rtol=0, atol=1e-13
        )


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("A0Z", (0.0, -1200.0, 0.0)),
        ("B0Z", (1200.0, 0.0, 0.0)),
        ("C0Y", (-1000.0, 0.0, 0.0)),
    ],
)
def test_squareness_turns_the_direction_of_travel_and_nothing_else(name, expected):
    model = model_of()
    point = [[3000.0, 1000.0, 1200.0]]
    deviation = exact_deviation(model, point, PROBE, one(model, name))[0] / 1e-6
    np.testing.assert_allclose(deviation, expected, atol=2e-3)
    np.testing.assert_allclose(deviation_basis(model, point, PROBE)[0, :, model.index(name)], expected)


def test_the_arm_of_a_rotation_is_what_lies_between_carriage_and_tool_point():
    model = model_of()
    point = [[4000.0, 1000.0, 1200.0]]  # X at its end: P_1 = 1
    column = deviation_basis(model, point, PROBE)[0]
    np.testing.assert_allclose(column[:, model.index("EAX[1]")], (0.0, -1200.0, 1250.0))
    np.testing.assert_allclose(column[:, model.index("EBX[1]")], (1200.0, 0.0, 0.0))
    np.testing.assert_allclose(column[:, model.index("ECX[1]")], (-1250.0, 0.0, 0.0))


def test_a_workpiece_side_axis_has_its_own_travel_in_its_arm():
    point = [[4000.0, 1000.0, 1200.0]]
    table = model_of("tool-Z-Y-bed-X-workpiece")
    column = model_of("tool-Z-Y-X-bed-workpiece")
    own = deviation_basis(table, point, PROBE)[0, :, table.index("ECX[1]")]
    np.testing.assert_allclose(own, (-1250.0, 4000.0, 0.0))
    other = deviation_basis(column, point, PROBE)[0, :, column.index("ECX[1]")]
    np.testing.assert_allclose(other, (-1250.0, 0.0, 0.0))


def test_cross_effect_by_hand():
    model = model_of()
    column = deviation_basis(model, [[100.0, 650.0, 1500.0 / 4]], PROBE)[0]  # v = 1/2, w = 1/4
    np.testing.assert_allclose(column[:, model.index("CROSS[b0]")], (0.0, 0.5, 0.0))
    np.testing.assert_allclose(column[:, model.index("CROSS[b1]")], (0.0, 0.125, 0.0))
    np.testing.assert_allclose(column[:, model.index("CROSS[b2]")], (0.0, 0.03125, 0.0))
    np.testing.assert_allclose(column[:, model.index("CROSS[c0]")], (0.0, 0.0, 0.5 * 900.0))
    np.testing.assert_allclose(column[:, model.index("CROSS[c1]")], (0.0, 0.0, 0.125 * 900.0))


def test_the_basis_is_the_derivative_of_the_plain_loop():
    rng = np.random.default_rng(8)
    chain = "tool-Z-bed-X-Y-workpiece"
    model = model_of(chain, order=3)
    points = rng.uniform(0.0, [4000.0, 1300.0, 1500.0], (2, 3))
    tool = np.array([50.0, 20.0, -200.0])
    basis = deviation_basis(model, points, tool)
    for k, name in enumerate(model.names):
        plus, minus = (
            plain_machine.deviations(chain, RANGES, points, tool, {name: sign * 1e-4}) for sign in (1.0, -1.0)
        )
        derivative = (plus - minus) / 2e-4
        np.testing.assert_allclose(basis[:, :, k], derivative, rtol=0, atol=2e-5)


def test_no_errors_no_deviation():
    model = model_of()
    points = [[0.0, 0.0, 0.0], [4000.0, 1300.0, 1500.0]]
    assert not exact_deviation(model, points, PROBE, np.zeros(model.size)).any()
    assert not linear_deviation(model, points, PROBE, np.zeros(model.size)).any()


def seen(model, *tools):
    """Return the rank of the field over all tools without rigid motions of the workspace."""
    rng = np.random.default_rng(9)
    points = rng.uniform(0.0, [4000.0, 1300.0, 1500.0], (200, 3))
    basis = np.vstack([deviation_basis(model, points, tool).reshape(-1, model.size) for tool in tools])
    tool_points = np.vstack([points + tool for tool in tools]) / 2000.0
    rigid = np.zeros((len(tool_points), 3, 6))
    for k, unit in enumerate(np.eye(3)):
        rigid[:, k, k] = 1.0
        rigid[:, :, 3 + k] = np.cross(unit, tool_points)
    frame, _ = np.linalg.qr(rigid.reshape(-1, 6))
    lengths = np.linalg.norm(basis, axis=0)
    basis = (basis - frame @ (frame.T @ basis)) / np.where(lengths > 0.0, lengths, 1.0)
    weights = np.linalg.svd(basis, compute_uv=False)
    return int((weights > 1e-9 * weights[0]).sum()), basis


def test_what_one_straight_probe_along_y_sees():
    model = model_of(order=4)
    rank, basis = seen(model, PROBE)
    assert (model.size, rank) == (74, 56)
    for name in model.names:
        invisible = name.startswith(("EBY", "EBZ"))
        assert (np.linalg.norm(basis[:, model.index(name)]) < 1e-12) == invisible, name
    for rotation, straightness, sign in (("EAY", "EZY", 250.0), ("ECY", "EXY", -250.0)):
        for k in (2, 3, 4):
            columns = deviation_basis(model, [[900.0, 700.0, 300.0]], PROBE)[0]
            merged = columns[:, model.index(f"{rotation}[{k}]")]
            np.testing.assert_allclose(merged, sign * columns[:, model.index(f"{straightness}[{k}]")])


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("CROSS[b0]", ["EYY[1]"]),
        ("CROSS[c0]", ["EZY[2]", "A0Z"]),
        ("ECY[1]", ["C0Y"]),
        ("EAY[1]", ["A0Z"]),
    ],
)
def test_parameters_that_are_others_but_for_a_rigid_motion(name, others):
    model = model_of()
    _, basis = seen(model, PROBE)
    column, rest = basis[:, model.index(name)], basis[:, [model.index(other) for other in others]]
    fit, *_ = np.linalg.lstsq(rest, column, rcond=None)
    assert np.linalg.norm(column) > 1e-3
    np.testing.assert_allclose(rest @ fit, column, rtol=0, atol=1e-13)


def test_a_second_tool_length_shows_more():
    rank, _ = seen(model_of(order=4), PROBE, np.array([0.0, 400.0, 0.0]))
    assert rank == 65


@pytest.mark.parametrize(
    ("points", "tool", "count", "says"),
    [
        ([[0.0, 0.0]], PROBE, 90, "axis positions has shape"),
        ([[0.0, 0.0, np.nan]], PROBE, 90, "not finite"),
        ([[0.0, 0.0, 0.0]], [0.0, 1.0], 90, "tool offset has shape"),
        ([[0.0, 0.0, 0.0]], PROBE, 89, "parameters has shape"),
    ],
)
def test_wrong_input_is_named(points, tool, count, says):
    model = model_of(terms=("b1", "b2", "c1"))
    for function in (exact_deviation, linear_deviation):
        with pytest.raises(DataError, match=says):
            function(model, points, tool, np.zeros(count))
