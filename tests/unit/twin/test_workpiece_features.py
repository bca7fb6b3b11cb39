"""Features of a workpiece: their errors agree with geometry, and their statements with what is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi, norm

from campaigns.features.true_features import draw
from campaigns.features.true_tests import true_figure_mm
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.identification import Misfit
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.workpiece import features as make
from twin.workpiece.acceptance import acceptance_tests, predict_tests
from twin.workpiece.best_place import place_map
from twin.workpiece.conformity import Conformity
from twin.workpiece.features import Feature, Measure, Tolerance
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import predict_features

RANGES = ((0.0, 3000.0), (0.0, 1500.0), (0.0, 1200.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 2)
TOOL = np.array([0.0, 0.0, -100.0])
AT_ORIGIN = Placement(np.zeros(3))
UM = 1e-3


@dataclass(frozen=True)
class Known:
    """What is known of a machine: `parameters` with independent errors of the standard deviation `deviation`."""

    parameters: Array
    deviation: float = 0.0
    scatter_mm2: float = 0.0
    model: ErrorModel = MODEL
    misfit: Misfit | None = None

    @property
    def covariance(self) -> Array:
        return self.deviation**2 * np.eye(self.model.size)


def drawn_machine(scatter_mm2: float = 0.0) -> Known:
    rng = np.random.default_rng(3)
    sizes = [1e-5 if parameter.unit == "rad" else 5e-3 for parameter in MODEL.parameters]
    return Known(rng.normal(size=MODEL.size) * sizes, scatter_mm2=scatter_mm2)


def predicted(known: Known, *features: Feature, at: Placement = AT_ORIGIN) -> list[float]:
    return [one.without_table.expected_mm for one in predict_features(known, features, at, TOOL)]


def test_errors_are_those_of_the_displaced_points() -> None:
    known, rng = drawn_machine(), np.random.default_rng(8)
    low, high = np.array(RANGES).T + TOOL
    for one in draw(low, high, 2, rng):
        true_mm = one.true_error(lambda points: exact_deviation(MODEL, points - TOOL, TOOL, known.parameters))
        # a flatness is the largest of many points, of which the feature and the truth take others
        allowed = 0.05 * abs(true_mm) if one.feature.measure is Measure.RANGE else 0.0
        assert predicted(known, one.feature, *one.datum) == [pytest.approx(true_mm, abs=allowed + 0.02 * UM)]


def test_acceptance_tests_are_those_of_the_displaced_points() -> None:
    known = drawn_machine()
    tests = acceptance_tests(RANGES, TOOL, np.array([1400.0, 700.0, 650.0]), (200.0, 500.0))
    assert len({test.feature.name for test in tests}) == len(tests) == 3 + 6 + 3 + 2 * 3 + 4
    for one in predict_tests(known, tests, TOOL):
        true_mm = true_figure_mm(one.test, lambda points: exact_deviation(MODEL, points - TOOL, TOOL, known.parameters))
        assert one.figure.without_table.expected_mm == pytest.approx(true_mm, abs=0.02 * UM), one.test.feature.name
        if one.test.feature.measure is Measure.RANGE:
            assert np.ptp(one.curve_mm) == pytest.approx(true_mm, abs=0.02 * UM)


def test_a_circle_that_leaves_the_machine_is_said() -> None:
    with pytest.raises(DataError, match="a circle of radius 800 mm in the plane XY leaves the travel"):
        acceptance_tests(RANGES, TOOL, np.array([1400.0, 700.0, 650.0]), (800.0,))
    with pytest.raises(DataError, match="outside the travel"):
        acceptance_tests(RANGES, TOOL, np.array([1400.0, 1700.0, 650.0]), (100.0,))


def test_a_turned_workpiece_has_the_errors_of_its_place() -> None:
    known = drawn_machine()
    here = make.distance("here", [1000.0, 500.0, 300.0], [1000.0, 900.0, 300.0])
    turned = Placement(np.array([1000.0, 500.0, 300.0]), np.pi / 2.0)
    there = make.distance("there", [0.0, 0.0, 0.0], [400.0, 0.0, 0.0])
    assert predicted(known, there, at=turned) == pytest.approx(predicted(known, here), abs=1e-9)
    face = partial(make.point, direction=[0.0, 1.0, 0.0])
    datum = [make.datum(str(n), at) for n, at in enumerate(np.array([[0, 0, 0], [300, 0, 0], [0, 300, 0]]))]
    whole = [replace(one, points=turned.in_machine(one.points)) for one in datum]
    assert predicted(known, face("x", [200.0, 100.0, 0.0]), *datum, at=turned) == pytest.approx(
        # the normal along Y of the workpiece points along -X of the machine
        predicted(known, make.point("x", [900.0, 700.0, 300.0], [-1.0, 0.0, 0.0]), *whole),
        abs=1e-9,
    )


def test_a_table_that_moves_everything_alike_changes_no_error() -> None:
    """A small rotation with a translation, as the anchor of a table may leave."""
    nodes = [np.array([low, high]) for low, high in RANGES]
    grid = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1)
    moved = np.cross([20e-6, -10e-6, 30e-6], grid) + np.array([0.01, 0.02, -0.01])
    x, y, z = nodes
    table = CompensationTable(x, y, z, moved, TOOL, Anchor(np.zeros(3)), np.zeros(grid.shape[:3], dtype=bool))
    low, high = np.array(RANGES).T + TOOL
    for one in draw(low, high, 1, np.random.default_rng(4)):
        (found,) = predict_features(drawn_machine(), [one.feature, *one.datum], AT_ORIGIN, TOOL, table)
        assert found.with_table is not None
        assert found.with_table.expected_mm == pytest.approx(found.without_table.expected_mm, abs=1e-9)


def test_the_uncertainty_of_a_distance_is_that_of_its_scatter() -> None:
    """Two points with independent errors of 1 µm in each direction: √2 µm, whatever the direction."""
    (one,) = predict_features(
        Known(np.zeros(MODEL.size), scatter_mm2=UM**2),
        [make.distance("d", [0.0, 0.0, 0.0], [300.0, 400.0, 500.0])],
        AT_ORIGIN,
        TOOL,
    )
    assert one.without_table.expanded_mm == pytest.approx(2.0 * np.sqrt(2.0) * UM)
    assert one.without_table.high_mm == pytest.approx(norm.ppf(0.975) * np.sqrt(2.0) * UM)


def test_a_position_has_the_distribution_of_a_length_and_scatter_only_lengthens_it() -> None:
    """A hole among datum points far off, with independent errors of 1 µm: twice a length with chi distribution."""
    datum = [make.datum(f"{n}", at) for n, at in enumerate(np.array([[0, 0, 0], [900, 0, 0], [0, 900, 0]]))] * 60
    hole = make.position("hole", [300.0, 300.0, 0.0], [0.0, 0.0, 1.0])
    (one,) = predict_features(Known(np.zeros(MODEL.size), scatter_mm2=UM**2), [hole, *datum], AT_ORIGIN, TOOL)
    assert one.without_table.high_mm == pytest.approx(2.0 * UM * chi(2).ppf(0.975), rel=0.05)
    assert one.without_table.low_mm == 0.0


@pytest.mark.parametrize(
    ("expected_um", "conformity"),
    [
        (0.0, Conformity.CONFORMS),
        (7.9, Conformity.CONFORMS),
        (8.2, Conformity.UNDECIDED),
        (-8.2, Conformity.UNDECIDED),
        (11.8, Conformity.UNDECIDED),
        (12.1, Conformity.DOES_NOT_CONFORM),
    ],
)
def test_the_guard_band_is_the_expanded_uncertainty(expected_um: float, conformity: Conformity) -> None:
    """Limits of ±10 µm, U = 2 µm (k = 2): stated up to 10 - 1.96 µm, and from 10 + 1.96 µm on."""
    distance = make.distance("d", [0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], Tolerance(-10.0 * UM, 10.0 * UM))
    parameters = np.zeros(MODEL.size)
    parameters[MODEL.index("EXX[1]")] = 1.0
    per_unit = predicted(Known(parameters), distance)[0]
    known = Known(parameters * expected_um * UM / per_unit, scatter_mm2=0.5 * UM**2)
    (one,) = predict_features(known, [distance], AT_ORIGIN, TOOL)
    assert one.without_table.expanded_mm == pytest.approx(2.0 * UM)
    assert one.without_table.conformity is conformity


def test_the_best_place_is_where_the_machine_errs_least() -> None:
    known = drawn_machine(scatter_mm2=1e-8)
    plate = [make.distance("d", [0.0, 0.0, 200.0], [600.0, 300.0, 200.0], Tolerance(-5.0 * UM, 5.0 * UM))]
    places = place_map(known, plate, AT_ORIGIN, TOOL, counts=(5, 3))
    i, j = places.best
    errors = [
        abs(predicted(known, *plate, at=Placement(np.array([x, y, 0.0])))[0]) for x in places.x_mm for y in places.y_mm
    ]
    assert int(np.argmin(errors)) == i * len(places.y_mm) + j
    assert places.x_mm[-1] + 600.0 == RANGES[0][1]


@pytest.mark.parametrize(
    ("features", "said"),
    [
        ([make.distance("long", [0.0, 0.0, 0.0], [3100.0, 0.0, 0.0])], "long needs X 3100.0 mm, beyond"),
        ([make.position("lone", [9.0, 9.0, 0.0], [0.0, 0.0, 1.0])], "the points of lone do not set"),
        ([make.datum("A", [0.0, 0.0, 0.0])], "there is no feature to predict"),
    ],
)
def test_what_cannot_be_predicted_is_said(features: list[Feature], said: str) -> None:
    with pytest.raises(DataError, match=said):
        predict_features(drawn_machine(), features, AT_ORIGIN, TOOL)


@settings(max_examples=20)
@given(st.lists(st.floats(-900.0, 900.0), min_size=6, max_size=6), st.floats(-3.0, 3.0))
def test_what_reaches_to_the_edge_of_the_travel_can_be_predicted(numbers: list[float], turned_rad: float) -> None:
    low = np.round(numbers[:3], 1)
    x, y, z = ((float(one), float(one) + 1200.3) for one in low)
    ranges = (x, y, z)
    model, offset = replace(MODEL, ranges_mm=ranges), np.round(numbers[3:], 1)
    known = Known(np.zeros(MODEL.size), model=model)
    middle = np.mean(ranges, axis=1)
    assert len(predict_tests(known, acceptance_tests(model.ranges_mm, offset, middle, (600.0,)), offset)) == 19
    plate = [make.distance("d", [0.1, 0.7, 0.0], [300.3, 411.9, 0.0])]
    at = Placement(np.array([0.0, 0.0, middle[2] + offset[2]]), turned_rad)
    assert place_map(known, plate, at, offset, counts=(2, 2)).criterion.shape == (2, 2)


@pytest.mark.parametrize(
    ("lower_um", "upper_um", "smaller_um", "larger_um"),
    [
        (None, 12.0, 3.0, 9.0),
        (None, 0.0, -2.0, 2.0),
        (None, -5.0, -7.0, -4.0),
        (5.0, None, 8.0, 4.0),
        (-4.0, 4.0, 0.0, 5.0),
    ],
)
def test_an_error_beyond_a_limit_uses_more_than_its_tolerance(
    lower_um: float | None, upper_um: float | None, smaller_um: float, larger_um: float
) -> None:
    limits = Tolerance(*(None if one is None else one * UM for one in (lower_um, upper_um)))
    parameters = np.zeros(MODEL.size)
    parameters[MODEL.index("EXX[1]")] = 1.0
    bar = make.distance("d", [0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], limits)
    per_unit = predicted(Known(parameters), bar)[0]
    shares = [
        float(
            place_map(Known(parameters * error * UM / per_unit), [bar], AT_ORIGIN, TOOL, counts=(1, 1)).criterion[0, 0]
        )
        for error in (smaller_um, larger_um)
    ]
    assert shares[0] < shares[1] < np.inf
    assert (shares[1] > 1.0) == (larger_um != 9.0)
    assert shares[0] < 1.0


def test_a_workpiece_that_fits_nowhere_is_said() -> None:
    with pytest.raises(DataError, match=r"needs 1600.0 mm along Y"):
        place_map(drawn_machine(), [make.distance("d", [0.0, 0.0, 0.0], [0.0, 1600.0, 0.0])], AT_ORIGIN, TOOL)


@pytest.mark.parametrize(
    "wrong",
    [
        Tolerance,
        lambda: Tolerance(2.0, 1.0),
        lambda: make.distance("d", [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]),
        lambda: make.point("p", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        lambda: make.diameter("b", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], -4.0),
        lambda: make.position("h", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], Tolerance(-1.0, 1.0)),
    ],
)
def test_impossible_features_are_refused(wrong: object) -> None:
    assert callable(wrong)
    with pytest.raises(DataError):
        wrong()
