"""Predicted figures of positioning after ISO 230-2:2014 that need repeated approaches from both sides.

The mean deviations of an axis follow from the estimate of a machine. Its lost motion and its repeatability do not: they
are taken from what a run has measured at one place, by oblique touches of a ball (`twin.artefact.reversal`). A touch
scatters with the probe and with the other axis that moves. The share of the tested axis in this scatter is not known,
so it is drawn between none and all; and lost motion is allowed to change along the travel.

The figures are those of one measurement as the standard asks for it, with five approaches of every target from each
side: the propagation of distributions (JCGM 101) draws the approaches too, since the largest of many standard
deviations of five readings is larger than the true one. They are those of the whole travel also if it is longer than
2000 mm: the standard states A and R only for a part of such an axis, and the titles say so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES
from twin.workpiece.acceptance import AcceptanceTest, PredictedTest
from twin.workpiece.conformity import Conformity
from twin.workpiece.features import Feature, FeatureKind, Measure
from twin.workpiece.machine_field import MachineField, MachineKnowledge
from twin.workpiece.prediction import COVERAGE, FeatureError, FeaturePrediction

STANDARD = "ISO 230-2"
APPROACHES = 5
"""Approaches of each target from each side (ISO 230-2:2014, 5.3)."""
GROWTH_PER_MM = 0.5e-6
"""Assumed standard uncertainty of the change of lost motion along the travel, per mm: it is measured at one place."""
TITLES: Mapping[str, str] = {
    "A": "accuracy of positioning of {axis}",
    "A±": "accuracy of positioning of {axis} from one side",
    "E": "systematic deviation of positioning of {axis}",
    "R": "repeatability of positioning of {axis}",
    "R±": "repeatability of positioning of {axis} from one side",
    "B": "reversal of {axis}",
}
LONGEST_MM = 2000.0
"""Longest travel for which ISO 230-2:2014 asks for five approaches of each target (5.3.2). Of a longer axis, the whole
travel is approached once from each side (5.3.3), which gives E, B and M; A and R are then stated for a part of 2000 mm
that is agreed."""
_OF_A_PART = ("A", "A±", "R", "R±")
_NEED_LOST_MOTION = ("A", "E", "R", "B")
_NEED_SCATTER = ("A", "A±", "R", "R±", "B")
FEWEST_FREEDOM = 3
"""Degrees of freedom from which a scatter is stated. With one it has no finite mean, with two no finite variance: a
figure would lie outside its own limits, or differ from one set of draws to the next."""
_DRAWS = 1000
_SEED = 23


@dataclass(frozen=True)
class AxisRepeats:
    """Repeatability and lost motion of an axis as a run has measured them, in mm.

    `scatter_mm` is the standard deviation of touches for which the axis came from the same side, with `freedom` degrees
    of freedom; None if it was not measured. `lost_mm` is the lost motion and `lost_sigma_mm` its standard uncertainty,
    measured at the axis position `at_mm`; None if it was not measured.

    Raises DataError if a standard deviation is negative, or if the scatter has fewer than `FEWEST_FREEDOM` degrees of
    freedom.
    """

    scatter_mm: float | None = None
    freedom: int = 0
    lost_mm: float | None = None
    lost_sigma_mm: float = 0.0
    at_mm: float = 0.0

    def __post_init__(self) -> None:
        if min(self.scatter_mm or 0.0, self.lost_sigma_mm) < 0.0:
            raise DataError("a standard deviation of repeated touches cannot be negative")
        if self.scatter_mm is not None and self.freedom < FEWEST_FREEDOM:
            raise DataError(
                f"a scatter with {self.freedom} degrees of freedom is too uncertain: {FEWEST_FREEDOM} are needed",
                hint="Touch more often",
            )

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures that can be stated."""
        return tuple(
            name
            for name in TITLES
            if (self.lost_mm is not None or name not in _NEED_LOST_MOTION)
            and (self.scatter_mm is not None or name not in _NEED_SCATTER)
        )


def predict_positioning(
    estimate: MachineKnowledge,
    tests: Sequence[AcceptanceTest],
    repeats: Mapping[str, AxisRepeats],
    tool_offset: Array,
    table: CompensationTable | None = None,
) -> tuple[PredictedTest, ...]:
    """Return the figures of positioning of all axes that `repeats` lets predict, by the letter of the axis.

    `tests` are those of `acceptance_tests`, whose lines of positioning are taken. The figures have no curves.
    """
    found: list[PredictedTest] = []
    for test in tests:
        axis = test.feature.name.removeprefix("M ")
        if test.standard == STANDARD and axis in repeats and repeats[axis].figures:
            found += _figures(estimate, test, axis, repeats[axis], tool_offset, table)
    return tuple(found)


def _figures(
    estimate: MachineKnowledge,
    test: AcceptanceTest,
    axis: str,
    repeats: AxisRepeats,
    tool_offset: Array,
    table: CompensationTable | None,
) -> list[PredictedTest]:
    feature = test.feature
    axis_positions = feature.points - tool_offset
    field = MachineField.at(estimate, axis_positions, tool_offset)
    spread = field.spread_of(feature.matrix, slice(None))
    approaches = _Approaches.drawn(repeats, axis_positions[:, AXES.index(axis)])
    states = [feature.matrix @ field.expected]
    if table is not None:
        states.append(states[0] + feature.matrix @ table.at(axis_positions).reshape(-1))
    # The scatter of unknown shape is counted in full at the upper end and not at all at the lower end.
    errors = [
        {
            name: _error(*(approaches.figures(mean, one)[name] for one in (spread.smooth, spread.whole)))
            for name in TITLES
        }
        for mean in states
    ]
    found = []
    for name in repeats.figures:
        title = _title(name, axis, test.along)
        own = Feature(
            f"{name} {axis}", FeatureKind.ACCEPTANCE_TEST, feature.points, feature.matrix, Measure.RANGE, False
        )
        corrected = None if table is None else errors[1][name]
        found.append(
            PredictedTest(
                AcceptanceTest(STANDARD, title, own, test.along, test.deviations),
                FeaturePrediction(own, errors[0][name], corrected),
                np.zeros(0),
                np.zeros(0),
                None,
            )
        )
    return found


def _title(name: str, axis: str, along: Array) -> str:
    """Return what a figure means, for targets at `along` (n,) in mm."""
    title = TITLES[name].format(axis=axis)
    if name in _OF_A_PART and float(np.ptp(along)) > LONGEST_MM:
        return f"{title}, over more than the {LONGEST_MM:.0f} mm for which the standard states it"
    return title


@dataclass(frozen=True, eq=False)
class _Approaches:
    """Draws of what repeated approaches of n targets add to the mean deviations.

    `lost` (draws, n) is the lost motion in mm, `means` (draws, 2, n) the mean scatter of the approaches from each side,
    and `deviations` (draws, 2, n) their standard deviations.
    """

    lost: Array
    means: Array
    deviations: Array

    @classmethod
    def drawn(cls, repeats: AxisRepeats, along: Array) -> _Approaches:
        rng = np.random.default_rng(_SEED)
        lost = np.zeros((_DRAWS, len(along)))
        if repeats.lost_mm is not None:
            lost += repeats.lost_mm + repeats.lost_sigma_mm * rng.standard_normal((_DRAWS, 1))
            lost += GROWTH_PER_MM * rng.standard_normal((_DRAWS, 1)) * (along - repeats.at_mm)
        sigma = np.zeros((_DRAWS, 1, 1))
        if repeats.scatter_mm is not None:
            known = np.sqrt(repeats.freedom / rng.chisquare(repeats.freedom, (_DRAWS, 1, 1)))
            sigma = repeats.scatter_mm * known * rng.uniform(0.0, 1.0, (_DRAWS, 1, 1))
        shape, freedom = (_DRAWS, 2, len(along)), APPROACHES - 1
        return cls(
            lost,
            sigma * rng.standard_normal(shape) / np.sqrt(APPROACHES),
            sigma * np.sqrt(rng.chisquare(freedom, shape) / freedom),
        )

    def figures(self, mean: Array, covariance: Array) -> dict[str, Array]:
        """Return draws of each figure in mm, for the expected mean deviations (n,) in mm and their covariance (n, n) in
        mm² (ISO 230-2:2014, 3.9 to 3.21)."""
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(_SEED + 1).standard_normal((_DRAWS, len(mean)))
        middle = (mean + normal @ root.T)[:, None, :]
        side = np.stack((-0.5 * self.lost, 0.5 * self.lost), axis=1)
        at = middle + side + self.means
        upper, lower = at + 2.0 * self.deviations, at - 2.0 * self.deviations
        reversal = np.abs(at[:, 0] - at[:, 1])
        of_side = 4.0 * self.deviations
        both = np.maximum(0.5 * of_side.sum(axis=1) + reversal, of_side.max(axis=1))
        return {
            "A": upper.max(axis=(1, 2)) - lower.min(axis=(1, 2)),
            "A±": upper[:, 0].max(axis=1) - lower[:, 0].min(axis=1),
            "E": at.max(axis=(1, 2)) - at.min(axis=(1, 2)),
            "R": both.max(axis=1),
            "R±": of_side[:, 0].max(axis=1),
            "B": reversal.max(axis=1),
        }


def _error(least: Array, most: Array) -> FeatureError:
    low = float(np.quantile(least, 0.5 * (1.0 - COVERAGE)))
    high = float(np.quantile(most, 0.5 * (1.0 + COVERAGE)))
    expected = 0.5 * float(least.mean() + most.mean())
    return FeatureError(expected, 0.5 * (high - low), low, high, Conformity.NO_TOLERANCE)
