"""Predicted figures of acceptance tests, from an estimate and a table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import translated
from agent.workpiece.estimate_and_table import read_estimate_and_table
from agent.workpiece.measured_repeats import MeasuredRepeats, measured_repeats
from agent.workpiece.predicted_features import error_document
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM
from twin.workpiece.acceptance import PredictedTest, acceptance_tests, axis_line, predict_tests
from twin.workpiece.angles import predict_angles
from twin.workpiece.machine_field import MachineKnowledge
from twin.workpiece.positioning import predict_positioning

_DIGITS = 4
_RADII_MM = (150.0, 100.0, 50.0, 25.0, 10.0)
"""Usual radii of ballbars and of circles on a grid plate."""


@dataclass(frozen=True)
class AcceptanceRequest:
    """Files of a prediction, and the place of the tests. `centre_mm` is None for the middle of the travel; for the
    other files and for `tool_offset_mm`, see `read_estimate_and_table`."""

    estimate: Path
    table: Path | None
    without_table: bool
    centre_mm: tuple[float, float, float] | None
    radii_mm: tuple[float, ...]
    tool_offset_mm: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class PredictedTests:
    """Predicted figures and curves of acceptance tests about `centre_mm` (3,). `table` is the name of the table, as
    a rule its file, and None without one.

    `tests` follow from the geometry alone. `angles` are the angular error motions. `positioning` are the figures of ISO
    230-2 that also need what the run has measured of repeatability and lost motion; `not_measured` says which of them
    are missing and why.
    """

    tests: tuple[PredictedTest, ...]
    centre_mm: Array
    tool_offset_mm: Array
    table: str | None
    angles: tuple[PredictedTest, ...] = ()
    positioning: tuple[PredictedTest, ...] = ()
    not_measured: tuple[str, ...] = ()

    @property
    def all_tests(self) -> tuple[PredictedTest, ...]:
        """All figures in the order in which they are listed."""
        return (*self.tests, *self.angles, *self.positioning)

    @property
    def heading(self) -> str:
        """Line that says where the tests are."""
        centre, offset = ("{:g}, {:g}, {:g}".format(*values) for values in (self.centre_mm, self.tool_offset_mm))
        return f"Lines and circles through {centre} mm, tool offset {offset} mm"

    def as_json(self) -> dict[str, Any]:
        """Return the prediction as a JSON object, with figures and curves in µm."""
        return {
            "centre_mm": self.centre_mm.tolist(),
            "tool_offset_mm": self.tool_offset_mm.tolist(),
            "table": self.table,
            "tests": [_document(one) for one in self.all_tests],
            "not_measured": list(self.not_measured),
        }


def predict_acceptance(request: AcceptanceRequest) -> PredictedTests:
    """Return the predicted figures of acceptance tests.

    Raises InputError, which names the file and the row, column or key, if a file is invalid, or if a line or circle
    leaves the travel for which the machine was identified.
    """
    known = read_estimate_and_table(request.estimate, request.table, request.without_table, request.tool_offset_mm)
    repeats = measured_repeats(request.estimate)
    place = PlaceOfTests(known.tool_offset_mm, request.centre_mm, request.radii_mm)
    return predicted_tests(known.estimate, known.table, known.table_name, place, repeats)


@dataclass(frozen=True, eq=False)
class PlaceOfTests:
    """Place of acceptance tests: the offset (3,) of the tool in mm, the axis position in mm through which lines and
    circles run (None for the middle of the travel), and the radii of the circles in mm (empty for a usual one)."""

    tool_offset_mm: Array
    centre_mm: tuple[float, float, float] | None = None
    radii_mm: tuple[float, ...] = ()


def predicted_tests(
    estimate: MachineKnowledge,
    table: CompensationTable | None,
    table_name: str | None,
    place: PlaceOfTests,
    repeats: MeasuredRepeats,
) -> PredictedTests:
    """Return the predicted figures of acceptance tests of the machine of `estimate`. Raises InputError if a line or
    circle leaves the travel for which the machine was identified."""
    ranges, offset = estimate.model.ranges_mm, place.tool_offset_mm
    centre = np.array(place.centre_mm or np.mean(ranges, axis=1))
    radii_mm = place.radii_mm or _fitting_radius(ranges, centre)
    with translated():
        tests = acceptance_tests(ranges, offset, centre, radii_mm)
        predicted = predict_tests(estimate, tests, offset, table)
        lines = tuple(axis_line(ranges, centre, axis) for axis in range(len(AXES)))
        angles = predict_angles(estimate, lines, offset, with_table=table is not None)
        positioning = predict_positioning(estimate, tests, repeats.axes, offset, table)
    return PredictedTests(predicted, centre, offset, table_name, angles, positioning, repeats.not_measured)


def _fitting_radius(ranges: Ranges, centre: Array) -> tuple[float, ...]:
    """Return the largest of the usual radii in mm with which the circles stay inside the travel; empty if none does."""
    room = float(min(np.min(np.abs(np.array(ranges).T - centre), axis=0)))
    return next(((radius,) for radius in _RADII_MM if radius <= room), ())


def _document(one: PredictedTest) -> dict[str, Any]:
    with_table = one.figure.with_table
    return {
        "standard": one.test.standard,
        "figure": one.test.feature.name,
        "meaning": one.test.title,
        "without_table": _figure(error_document(one.figure.without_table)),
        "with_table": None if with_table is None else _figure(error_document(with_table)),
        **(_curve(one) if len(one.curve_mm) > 1 else {}),
    }


def _curve(one: PredictedTest) -> dict[str, Any]:
    circle = one.test.standard == "ISO 230-4"
    return {
        "angle_rad" if circle else "position_mm": np.round(one.test.along, _DIGITS).tolist(),
        "curve_um": _um(one.curve_mm),
        "curve_with_table_um": None if one.corrected_mm is None else _um(one.corrected_mm),
        "curve_expanded_um": _um(one.expanded_mm),
    }


def _figure(document: dict[str, Any]) -> dict[str, Any]:
    """Return the figure without a statement of conformity: the tests have no tolerance."""
    return {name: value for name, value in document.items() if name != "conformity"}


def _um(values_mm: Array) -> list[float]:
    return [round(float(value), _DIGITS) for value in UM_PER_MM * values_mm]
