"""Predicted errors of the features of a workpiece, with their uncertainty, without and with a compensation table.

The tool reaches the points of a feature with the errors that the estimate states, and the feature gets them. Cutting
forces, wear, the temperature of the workpiece and its clamping are not part of the prediction.

`campaigns.features` compares the intervals with true errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.rigid_motion import rigid_fields
from twin.workpiece.conformity import Conformity, decide
from twin.workpiece.features import Feature, FeatureKind, Measure, Tolerance
from twin.workpiece.machine_field import MachineField, MachineKnowledge, Spread
from twin.workpiece.placement import Placement, check_inside

COVERAGE_FACTOR = 2.0
COVERAGE = 0.95
_NORMAL_QUANTILE = 1.959964  # ends of the interval that contains 95 % of a normal distribution
_BLOCK_POINTS = 3000
_DRAWS = 2000  # the ends of a 95 % interval scatter by some per cent of its width
_SEED = 20  # the same draws for all features: equal features get equal figures
_RIGID_MOTIONS = 6
_LEVER_MM = 100.0  # scale on which rotations and translations are compared
_SINGULAR = 1e-9  # of the largest singular value: datum points on one line leave a rotation free
_CERTAIN = 1e-12  # of the largest variance of a direction


@dataclass(frozen=True)
class FeatureError:
    """Predicted error of a feature in mm.

    `expected_mm` is the expected error and `expanded_mm` the expanded uncertainty U (k = 2). `low_mm` and `high_mm` are
    the ends of the interval that contains the error with a probability of 95 %. For an error that has a sign they are
    `expected_mm` ± 1.96 U / 2. For a position or a flatness, which cannot be negative, U is half the width of the
    interval. `conformity` is the statement about the tolerance.
    """

    expected_mm: float
    expanded_mm: float
    low_mm: float
    high_mm: float
    conformity: Conformity


@dataclass(frozen=True)
class FeaturePrediction:
    """Predicted error of one feature on the machine without compensation, and with a compensation table; `with_table`
    is None if no table was given."""

    feature: Feature
    without_table: FeatureError
    with_table: FeatureError | None


def predict_features(
    estimate: MachineKnowledge,
    features: Sequence[Feature],
    placement: Placement,
    tool_offset: Array,
    table: CompensationTable | None = None,
) -> tuple[FeaturePrediction, ...]:
    """Return the predicted errors of `features`, in their order, for a workpiece at `placement` and a tool with the
    offset `tool_offset` (3,) in mm.

    Features of the kind `datum` set the coordinate system of the workpiece: the rigid motion that fits the
    displacements of their points best is removed from all features that depend on it. Without any, the points of all
    such features are taken. They are not in the result. Raises DataError if a point is outside the travel for which the
    machine was identified, or if the datum points do not determine a rigid motion.
    """
    judged = [feature for feature in features if feature.kind is not FeatureKind.DATUM]
    if not judged:
        raise DataError("there is no feature to predict", hint="Give at least one that is not a datum")
    for feature in features:
        check_inside(feature.name, placement.in_machine(feature.points) - tool_offset, estimate.model.ranges_mm)
    datum = _datum(features, placement)
    found: list[FeaturePrediction] = []
    for block in _blocks(judged):
        found += _predicted(estimate, block, datum, placement, tool_offset, table)
    return tuple(found)


def _blocks(features: Sequence[Feature]) -> Iterator[Sequence[Feature]]:
    """Yield the features in blocks of which each fits into memory with the derivatives at its points."""
    block: list[Feature] = []
    for feature in features:
        if block and sum(len(one.points) for one in block) + len(feature.points) > _BLOCK_POINTS:
            yield block
            block = []
        block.append(feature)
    yield block


def _predicted(
    estimate: MachineKnowledge,
    features: Sequence[Feature],
    datum: _Datum | None,
    placement: Placement,
    tool_offset: Array,
    table: CompensationTable | None,
) -> Iterator[FeaturePrediction]:
    own = [placement.in_machine(feature.points) for feature in features]
    points = np.concatenate(own if datum is None else [*own, datum.points])
    field = MachineField.at(estimate, points - tool_offset, tool_offset)
    corrections = None if table is None else table.at(points - tool_offset).reshape(-1)
    start = 0
    for feature, at in zip(features, own, strict=True):
        used = np.arange(start, start + at.size)
        start += at.size
        weights = feature.matrix.reshape(-1, 3) @ placement.rotation.T
        operator = weights.reshape(len(feature.matrix), -1)
        if datum is not None and feature.depends_on_datum:
            operator = np.concatenate((operator, -operator @ datum.carried_to(at)), axis=1)
            used = np.concatenate((used, np.arange(3 * len(points) - datum.points.size, 3 * len(points))))
        numbers = operator @ field.expected[used]
        spread = field.spread_of(operator, used)
        without = error_of(feature, numbers, spread)
        corrected = None if corrections is None else error_of(feature, numbers + operator @ corrections[used], spread)
        yield FeaturePrediction(feature, without, corrected)


@dataclass(frozen=True, eq=False)
class _Datum:
    """Points (n, 3) of the workpiece in mm, in the coordinates of the machine, to which its coordinate system is
    fitted. `fit` (6, 3n) takes their displacements to the rigid motion about `middle` (3,) that fits them best."""

    points: Array
    middle: Array
    fit: Array

    def carried_to(self, points: Array) -> Array:
        """Return the matrix (3m, 3n) that takes the displacements of the datum points to those of m `points` by the
        rigid motion alone."""
        return np.asarray(rigid_fields(points, self.middle, _LEVER_MM).reshape(points.size, 6) @ self.fit)


def _datum(features: Sequence[Feature], placement: Placement) -> _Datum | None:
    """Return the datum of the features; None if no feature depends on one."""
    dependent = [feature for feature in features if feature.depends_on_datum]
    stated = [feature for feature in features if feature.kind is FeatureKind.DATUM]
    if all(feature.kind is FeatureKind.DATUM for feature in dependent):
        return None
    points = placement.in_machine(np.concatenate([feature.points for feature in stated or dependent]))
    middle = points.mean(axis=0)
    motions = rigid_fields(points, middle, _LEVER_MM).reshape(points.size, 6)
    sizes = np.linalg.svd(motions, compute_uv=False)
    if len(sizes) < _RIGID_MOTIONS or sizes[-1] < _SINGULAR * sizes[0]:
        names = ", ".join(dict.fromkeys(feature.name for feature in stated or dependent))
        raise DataError(
            f"the points of {names} do not set the coordinate system of the workpiece",
            hint="Positions and points need at least three datum points that are not on one line",
        )
    return _Datum(points, middle, np.asarray(np.linalg.pinv(motions)))


def error_of(feature: Feature, numbers: Array, spread: Spread) -> FeatureError:
    """Return the error of a feature from its expected `numbers` (k,) in mm and their spread."""
    if feature.measure is Measure.SIGNED:
        return _signed_error(float(numbers[0]), float(np.sqrt(spread.whole[0, 0])), feature.tolerance)
    # Scatter that is independent at each point makes these errors larger than scatter of any other shape. Its true
    # shape is not known: the upper end counts all of it, the lower end none.
    least, most = (_magnitudes(feature.measure, numbers, one) for one in (spread.smooth, spread.whole))
    low = float(np.quantile(least, 0.5 * (1.0 - COVERAGE)))
    high = float(np.quantile(most, 0.5 * (1.0 + COVERAGE)))
    expected, limits = 0.5 * float(least.mean() + most.mean()), feature.tolerance
    if limits is None:
        return FeatureError(expected, 0.5 * (high - low), low, high, Conformity.NO_TOLERANCE)
    conformity = decide(*sorted(float(np.mean(_is_inside(values, limits))) for values in (least, most)))
    return FeatureError(expected, 0.5 * (high - low), low, high, conformity)


def _magnitudes(measure: Measure, numbers: Array, covariance: Array) -> Array:
    """Return drawn values of a position or a flatness (JCGM 101), whose distributions have no closed form."""
    root = _root(covariance)
    drawn = numbers + _draws(root.shape[1]) @ root.T
    return np.asarray(2.0 * np.linalg.norm(drawn, axis=1) if measure is Measure.ZONE else np.ptp(drawn, axis=1))


def _signed_error(expected: float, deviation: float, limits: Tolerance | None) -> FeatureError:
    half = _NORMAL_QUANTILE * deviation
    conformity = Conformity.NO_TOLERANCE
    if limits is not None:
        below = 0.0 if limits.lower_mm is None else _probability_below(limits.lower_mm - expected, deviation)
        above = 0.0 if limits.upper_mm is None else _probability_below(expected - limits.upper_mm, deviation)
        conformity = decide(1.0 - below - above, 1.0 - below - above)
    return FeatureError(expected, COVERAGE_FACTOR * deviation, expected - half, expected + half, conformity)


def _probability_below(margin_mm: float, deviation: float) -> float:
    return float(ndtr(margin_mm / deviation)) if deviation > 0.0 else float(margin_mm > 0.0)


def _is_inside(values: Array, limits: Tolerance) -> NDArray[np.bool_]:
    low = -np.inf if limits.lower_mm is None else limits.lower_mm
    high = np.inf if limits.upper_mm is None else limits.upper_mm
    return np.asarray((values >= low) & (values <= high))


def _root(covariance: Array) -> Array:
    """Return a matrix R (k, r) with R Rᵀ = `covariance` (k, k), without the directions that are certain."""
    values, vectors = np.linalg.eigh(covariance)
    known = values > _CERTAIN * max(float(values[-1]), 0.0)
    return np.asarray(vectors[:, known] * np.sqrt(values[known]))


@cache
def _draws(count: int) -> Array:
    """Return standard normal numbers (draws, count), in pairs of opposite sign."""
    half = np.random.default_rng(_SEED).standard_normal((_DRAWS // 2, count))
    return np.concatenate((half, -half))
