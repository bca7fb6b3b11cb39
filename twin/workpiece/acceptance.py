"""Figures of acceptance tests of a machine (ISO 230), as features that can be predicted and compared with a laser or a
ballbar.

Each test takes the displacements of the tool at points of a line or a circle to one figure. The names follow the
standards. Only the geometry is predicted here: reversal, repeatability and the servo errors of a moving ballbar are not
identified from balls that are touched at rest. Figures of ISO 230-2 that need them are in
`twin.workpiece.positioning`, angles in `twin.workpiece.angles`.

Points are in the coordinates of the machine, for the tip of the tool, in mm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES
from twin.workpiece.features import Feature, FeatureKind, Measure
from twin.workpiece.machine_field import MachineField, MachineKnowledge
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import COVERAGE_FACTOR, FeaturePrediction, predict_features

LINE_POINTS = 11
"""Target positions along a line; ISO 230-2 demands at least five per metre, and at least five in all."""
_PER_METRE = 5
CIRCLE_POINTS = 72
SLOPE_LENGTH_MM = 1000.0
"""Length over which an error of squareness is stated, in mm."""
_AS_IT_STANDS = Placement(np.zeros(3))


@dataclass(frozen=True, eq=False)
class AcceptanceTest:
    """One figure of an acceptance test. `standard` is the clause, `title` says what is measured. `feature` gives the
    figure, and `along` (n,) the position of each point in mm along the line, or its angle in rad on the circle.
    `deviations` (n, 3n) takes the displacements of the points to the curve that the standard draws."""

    standard: str
    title: str
    feature: Feature
    along: Array
    deviations: Array


def acceptance_tests(
    ranges_mm: Ranges, tool_offset: Array, centre_mm: Array, radii_mm: Sequence[float]
) -> tuple[AcceptanceTest, ...]:
    """Return the tests of a machine with three linear axes.

    `ranges_mm` are the axis positions over which it was identified. `centre_mm` (3,) is the axis position through which
    the lines of the axes pass and about which the circles run. Raises DataError if a circle leaves the ranges.
    """
    low, high = np.array(ranges_mm).T
    if not ((low <= centre_mm) & (centre_mm <= high)).all():
        raise DataError("the centre of the tests is outside the travel for which the machine was identified")
    tests = [
        *_positioning(low, high, centre_mm),
        *_straightness(low, high, centre_mm),
        *_squareness(low, high, centre_mm),
        *_circles(low, high, centre_mm, radii_mm),
        *_diagonals(low, high),
    ]
    return tuple(_at_the_tip(test, tool_offset) for test in tests)


@dataclass(frozen=True, eq=False)
class PredictedTest:
    """Predicted figure of an acceptance test and its curve.

    `curve_mm` (n,) is the expected curve of the machine without compensation and `expanded_mm` (n,) its expanded
    uncertainty (k = 2), which also applies to `corrected_mm` (n,), the curve with the table; it is None without one.
    """

    test: AcceptanceTest
    figure: FeaturePrediction
    curve_mm: Array
    expanded_mm: Array
    corrected_mm: Array | None


def predict_tests(
    estimate: MachineKnowledge,
    tests: Sequence[AcceptanceTest],
    tool_offset: Array,
    table: CompensationTable | None = None,
) -> tuple[PredictedTest, ...]:
    """Return the predicted figures of acceptance tests, without and with a compensation table, for a tool with the
    offset `tool_offset` (3,) in mm."""
    figures = predict_features(estimate, [test.feature for test in tests], _AS_IT_STANDS, tool_offset, table)
    found = []
    for test, figure in zip(tests, figures, strict=True):
        axis_positions = test.feature.points - tool_offset
        field = MachineField.at(estimate, axis_positions, tool_offset)
        spread = field.spread_of(test.deviations, slice(None))
        corrected = None
        if table is not None:
            corrected = test.deviations @ (field.expected + table.at(axis_positions).reshape(-1))
        found.append(
            PredictedTest(
                test,
                figure,
                test.deviations @ field.expected,
                COVERAGE_FACTOR * np.sqrt(np.maximum(np.diagonal(spread.whole), 0.0)),
                corrected,
            )
        )
    return tuple(found)


def axis_line(ranges_mm: Ranges, centre_mm: Array, axis: int) -> tuple[Array, Array]:
    """Return the axis positions (n, 3) in mm of the targets on the line along an axis through `centre_mm` (3,), and
    their positions (n,) along it."""
    low, high = np.array(ranges_mm).T
    return _line(low, high, centre_mm, axis)


def _at_the_tip(test: AcceptanceTest, tool_offset: Array) -> AcceptanceTest:
    feature = test.feature
    moved = Feature(
        feature.name, feature.kind, feature.points + tool_offset, feature.matrix, feature.measure, False, None
    )
    return AcceptanceTest(test.standard, test.title, moved, test.along, test.deviations)


def _positioning(low: Array, high: Array, centre: Array) -> Iterator[AcceptanceTest]:
    for axis, name in enumerate(AXES):
        points, along = _line(low, high, centre, axis)
        displaced = _from_mean(len(points)) @ _component(len(points), np.eye(3)[axis])
        yield _ranged(
            "ISO 230-2", f"M {name}", f"range of the mean positioning deviations of {name}", points, along, displaced
        )


def _straightness(low: Array, high: Array, centre: Array) -> Iterator[AcceptanceTest]:
    for axis, name in enumerate(AXES):
        points, along = _line(low, high, centre, axis)
        left = _without(np.stack((np.ones_like(along), along), axis=1))
        for across, direction in enumerate(AXES):
            if across != axis:
                # deviations from the least-squares line, as the standard permits beside the minimum zone
                deviations = left @ _component(len(points), np.eye(3)[across])
                title = f"straightness of {name} in the direction of {direction}"
                yield _ranged("ISO 230-1", f"E{direction}{name}", title, points, along, deviations)


def _squareness(low: Array, high: Array, centre: Array) -> Iterator[AcceptanceTest]:
    for first, second in combinations(range(3), 2):
        (points, along), (others, along_others) = (_line(low, high, centre, axis) for axis in (first, second))
        # angle between the least-squares lines: positive if the angle between the positive axes is larger than 90°
        slopes = np.concatenate(
            (
                -_slope(along) @ _component(len(points), np.eye(3)[second]),
                -_slope(along_others) @ _component(len(others), np.eye(3)[first]),
            ),
            axis=1,
        )
        feature = Feature(
            f"squareness {AXES[second]} to {AXES[first]}",
            FeatureKind.ACCEPTANCE_TEST,
            np.concatenate((points, others)),
            SLOPE_LENGTH_MM * slopes,
            Measure.SIGNED,
            False,
        )
        both = np.concatenate((along, along_others))
        title = f"squareness of {AXES[second]} to {AXES[first]}, over 1000 mm"
        yield AcceptanceTest("ISO 230-1", title, feature, both, feature.matrix)


def _circles(low: Array, high: Array, centre: Array, radii_mm: Sequence[float]) -> Iterator[AcceptanceTest]:
    angles = 2.0 * np.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    for radius, (first, second) in product(radii_mm, combinations(range(3), 2)):
        plane = f"{AXES[first]}{AXES[second]}"
        radial = np.zeros((CIRCLE_POINTS, 3))
        radial[:, first], radial[:, second] = np.cos(angles), np.sin(angles)
        points = centre + radius * radial
        if not (radius > 0.0 and (points >= low).all() and (points <= high).all()):
            raise DataError(
                f"a circle of radius {radius:g} mm in the plane {plane} leaves the travel of the machine",
                hint="State a smaller radius, or another centre",
            )
        outwards = np.zeros((CIRCLE_POINTS, 3 * CIRCLE_POINTS))
        for at, direction in enumerate(radial):
            outwards[at, 3 * at : 3 * at + 3] = direction
        # centred on the least-squares circle: the ballbar is set up with an unknown centre
        centred = _without(np.stack((np.cos(angles), np.sin(angles)), axis=1)) @ outwards
        title = f"circularity in {plane}, radius {radius:g} mm, without reversal"
        yield _ranged("ISO 230-4", f"G {plane} {radius:g}", title, points, angles, centred)


def _diagonals(low: Array, high: Array) -> Iterator[AcceptanceTest]:
    for signs in product((1.0, -1.0), repeat=2):
        direction = np.array([1.0, *signs])
        ends = np.where(direction > 0.0, low, high), np.where(direction > 0.0, high, low)
        length = float(np.linalg.norm(ends[1] - ends[0]))
        along = np.linspace(0.0, length, _count(length))
        points = ends[0] + (along / length)[:, None] * (ends[1] - ends[0])
        displaced = _from_mean(len(points)) @ _component(len(points), (ends[1] - ends[0]) / length)
        mark = "".join("+" if sign > 0.0 else "-" for sign in direction)
        title = f"range of the mean deviations along the body diagonal {mark} of X, Y and Z"
        yield _ranged("ISO 230-6", f"diagonal {mark}", title, points, along, displaced)


def _ranged(standard: str, name: str, title: str, points: Array, along: Array, deviations: Array) -> AcceptanceTest:
    feature = Feature(name, FeatureKind.ACCEPTANCE_TEST, points, deviations, Measure.RANGE, False)
    return AcceptanceTest(standard, title, feature, along, deviations)


def _line(low: Array, high: Array, centre: Array, axis: int) -> tuple[Array, Array]:
    along = np.linspace(low[axis], high[axis], _count(float(high[axis] - low[axis])))
    points = np.tile(centre, (len(along), 1))
    points[:, axis] = along
    return points, along


def _count(length_mm: float) -> int:
    return max(LINE_POINTS, int(np.ceil(_PER_METRE * length_mm / 1000.0)) + 1)


def _component(count: int, direction: Array) -> Array:
    """Return the matrix (n, 3n) that takes displacements of n points to their components along `direction`."""
    return np.asarray(np.kron(np.eye(count), direction), dtype=np.float64)


def _from_mean(count: int) -> Array:
    """Return the matrix (n, n) that takes values to their deviations from the mean: no artefact shows where a scale
    begins."""
    return _without(np.ones((count, 1)))


def _without(columns: Array) -> Array:
    """Return the matrix (n, n) that removes the best fit of `columns` (n, k)."""
    basis = np.linalg.qr(columns)[0]
    return np.asarray(np.eye(len(columns)) - basis @ basis.T)


def _slope(along: Array) -> Array:
    """Return the row (1, n) that takes values at `along` to the slope of their least-squares line."""
    centred = along - along.mean()
    return np.asarray((centred / (centred @ centred))[None, :])
