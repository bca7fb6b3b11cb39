"""Predicted figures of acceptance tests, compared with the measurements of a laser interferometer and a ballbar.

Each test becomes one request to an instrument in front of the machine. The request states only where to measure; the
instrument evaluates its readings itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from agent.workpiece.predicted_tests import PredictedTests
from twin.arrays import Array
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM
from twin.workpiece.acceptance import AcceptanceTest, PredictedTest
from twin.workpiece.agreement import agrees, en_score
from twin.workpiece.features import Measure
from twin.workpiece.prediction import COVERAGE_FACTOR, FeatureError

Ask = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""Function that sends a request to the instruments and returns their answer."""

NO_TABLE = 0
"""Bank of the machine without compensation."""
LEAST_AGREEING = 0.9
"""Share of agreeing figures below which prediction and instruments contradict each other. One figure in twenty
disagrees by chance, and the figures of one machine are correlated."""
_POSITIONING = ("A", "E", "R", "B")
_DIGITS = 3


@dataclass(frozen=True, eq=False)
class MeasuredFigure:
    """Figure that an instrument has measured, with its standard uncertainty, both in µm (a squareness over 1000 mm).

    `curve_um` (n,) is the mean curve at `along` (n,), the distance from the start of the line in mm or the angle in
    rad; both are empty for a squareness.
    """

    value_um: float
    standard_uncertainty_um: float
    along: Array
    curve_um: Array

    @property
    def expanded_um(self) -> float:
        """Expanded uncertainty U (k = 2) in µm."""
        return COVERAGE_FACTOR * self.standard_uncertainty_um


@dataclass(frozen=True, eq=False)
class ComparedFigure:
    """Predicted and measured figure of a test, on the machine with its table if `with_table` is True."""

    test: PredictedTest
    with_table: bool
    measured: MeasuredFigure

    @property
    def predicted(self) -> FeatureError:
        error = self.test.figure.with_table if self.with_table else self.test.figure.without_table
        assert error is not None  # noqa: S101  a figure with table is measured only if it was predicted
        return error

    @property
    def en(self) -> float:
        """E_n score, see `twin.workpiece.agreement`."""
        error = self.predicted
        return en_score(
            UM_PER_MM * error.expected_mm,
            UM_PER_MM * error.expanded_mm,
            self.measured.value_um,
            self.measured.expanded_um,
        )

    @property
    def agrees(self) -> bool:
        return agrees(self.en)

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as a JSON object, in µm."""
        return {
            "standard": self.test.test.standard,
            "figure": self.test.test.feature.name,
            "meaning": self.test.test.title,
            "with_table": self.with_table,
            "predicted_um": round(UM_PER_MM * self.predicted.expected_mm, _DIGITS),
            "predicted_expanded_um": round(UM_PER_MM * self.predicted.expanded_mm, _DIGITS),
            "measured_um": round(self.measured.value_um, _DIGITS),
            "measured_expanded_um": round(self.measured.expanded_um, _DIGITS),
            "en": round(self.en, _DIGITS),
            "agrees": self.agrees,
        }


@dataclass(frozen=True, eq=False)
class InstrumentComparison:
    """Comparison of all figures. `predicted` are the tests, with the place where they were carried out."""

    predicted: PredictedTests
    figures: tuple[ComparedFigure, ...]

    @property
    def agreeing(self) -> int:
        return sum(figure.agrees for figure in self.figures)

    @property
    def contradicts(self) -> bool:
        """True if fewer figures agree than chance explains."""
        return self.agreeing < LEAST_AGREEING * len(self.figures)

    @property
    def text(self) -> str:
        """Sentence about the agreement."""
        largest = max(self.figures, key=lambda figure: abs(figure.en))
        return (
            f"{self.agreeing} of {len(self.figures)} figures agree (|En| ≤ 1); the largest score is {largest.en:+.2f}, "
            f"of {largest.test.test.feature.name} {'with' if largest.with_table else 'without'} table"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as a JSON object."""
        return {
            "centre_mm": self.predicted.centre_mm.tolist(),
            "agreeing": self.agreeing,
            "figures": [figure.as_json() for figure in self.figures],
        }


def compare_with_instruments(predicted: PredictedTests, ask: Ask, table_bank: int | None) -> InstrumentComparison:
    """Measure the figures of all tests without table and with the table in the bank `table_bank` of the controller,
    first those of the geometry and then those of positioning, and compare them with the prediction. Every measurement
    has a set-up of its own.

    If `table_bank` is None or no table was predicted, the machine is only measured without table. Angles are not
    measured, nor figures of positioning from one side alone.
    """
    positioning = [one for one in predicted.positioning if _is_measured(one.test)]
    tests = [*predicted.tests, *positioning]
    with_table = table_bank is not None and all(one.figure.with_table is not None for one in tests)
    banks = [NO_TABLE, table_bank] if with_table else [NO_TABLE]
    figures: list[ComparedFigure] = []
    for group, bank in product((predicted.tests, positioning), banks):
        for one in group:
            request = instrument_request(one.test, predicted.tool_offset_mm)
            answer = ask({**request, "bank": bank, "seed": len(figures) + 1})
            figures.append(ComparedFigure(one, bank != NO_TABLE, _measured(one.test, answer)))
    return InstrumentComparison(predicted, tuple(figures))


def _is_measured(test: AcceptanceTest) -> bool:
    """Return True if the interferometer evaluates this figure of positioning."""
    return test.feature.name.split()[0] in _POSITIONING


def instrument_request(test: AcceptanceTest, tool_offset_mm: Array) -> dict[str, Any]:
    """Return the request that states where the instrument measures the figure of `test`, in axis positions."""
    positions = test.feature.points - tool_offset_mm
    match test.standard, test.feature.name.split():
        case "ISO 230-4", (_, plane, radius):
            return {
                "do": "ballbar",
                "centre_mm": positions.mean(axis=0).tolist(),
                "radius_mm": float(radius),
                "plane": plane,
            }
        case "ISO 230-1", ("squareness", second, _, first):
            lines = _lines(positions, AXES.index(first))
            return {
                "do": "squareness",
                "lines_mm": [[line[0].tolist(), line[-1].tolist()] for line in lines],
                "plane": first + second,
                "targets": [len(line) for line in lines],
            }
        case "ISO 230-1", (error,):
            return {"do": "straightness", **_ends(positions), "across": error[1]}
        case _:
            return {"do": "interferometer", **_ends(positions)}


def _ends(positions: Array) -> dict[str, Any]:
    return {"from_mm": positions[0].tolist(), "to_mm": positions[-1].tolist(), "targets": len(positions)}


def _lines(positions: Array, first: int) -> tuple[Array, Array]:
    """Return the two lines of a squareness. The axis number `first` moves upwards along the whole of the first line;
    the second one begins where it does so no longer, even if the lines meet at their ends."""
    start = 1 + int(np.argmax(np.diff(positions[:, first]) <= 0.0))
    return positions[:start], positions[start:]


def _measured(test: AcceptanceTest, answer: Mapping[str, Any]) -> MeasuredFigure:
    match test.standard, test.feature.measure:
        case "ISO 230-1", Measure.SIGNED:
            # 1 µrad is 1 µm over 1000 mm
            return MeasuredFigure(
                float(answer["squareness_urad"]), float(answer["squareness_u_urad"]), np.zeros(0), np.zeros(0)
            )
        case "ISO 230-1", _:
            name, along = "straightness", "position_mm"
        case "ISO 230-4", _:
            name, along = "g_mean", "mean_angle_rad"
        case "ISO 230-2", _:
            name, along = test.feature.name.split()[0].lower(), "position_mm"
        case _:
            name, along = "m", "position_mm"
    return MeasuredFigure(
        float(answer[f"{name}_um"]),
        float(answer[f"{name}_u_um"]),
        np.array(answer[along], dtype=np.float64),
        _without_zero(test, answer["mean_um"]),
    )


def _without_zero(test: AcceptanceTest, curve_um: Sequence[float]) -> Array:
    """Return a curve as it is drawn: an interferometer does not know where the scale of the machine begins."""
    curve = np.array(curve_um, dtype=np.float64)
    return np.asarray(curve if test.standard == "ISO 230-4" else curve - curve.mean())
