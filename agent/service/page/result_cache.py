"""Results of a run as numbers for figures. They comprise the geometric errors with their uncertainty bands, and maps of
the deviation in the workspace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from agent.execution.run_record import read_record
from agent.reports.page import IdentificationData, ReportData
from agent.reports.page.error_curves import SQUARENESSES, ErrorCurve, cross_effect_curves, geometric_error_curves
from agent.reports.page.workspace_maps import PlaneMap, workspace_maps
from agent.reports.run_comparison import ErrorComparison, PlaneDifference, RunComparison, table_planes
from agent.reports.run_report import report_of
from agent.results.table_difference import TableDifference
from drivers.errors import InputError
from twin.arrays import Array

Document = dict[str, Any]
MAX_CACHED = 16


class ResultCache:
    """Cache of the results of the runs that were requested last. It is safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cached: dict[tuple[str, str, str], Document] = {}

    def curves(self, directory: Path, run_id: str) -> Document:
        """Return the curves of the geometric errors of a run. Raise InputError if the run has no estimate."""
        return self._of("curves", directory, run_id, _curves)

    def maps(self, directory: Path, run_id: str) -> Document:
        """Return the maps of the deviation and of its uncertainty for a run. Raise InputError if the run has no
        estimate."""
        return self._of("maps", directory, run_id, _maps)

    def _of(
        self, what: str, directory: Path, run_id: str, make: Callable[[ReportData, IdentificationData], Document]
    ) -> Document:
        """Return document `what` of a run from the cache. If it is not cached, make it with `make`.

        The document of a run in progress is not cached, since the estimate of that run may still change.
        """
        key = (what, str(directory), run_id)
        with self._lock:
            if key not in self._cached:
                record = read_record(directory, run_id)
                data = report_of(record)
                if data.identification is None:
                    raise InputError(
                        f"run {run_id} has no estimate", hint="the run ended before the errors were identified"
                    )
                document = make(data, data.identification)
                if record.ended is None:
                    return document
                self._cached[key] = document
                while len(self._cached) > MAX_CACHED:
                    self._cached.pop(next(iter(self._cached)))
            return self._cached[key]


def comparison_document(compared: RunComparison) -> Document:
    """Return the comparison of two runs with the curves and the maps that the page draws."""
    document, identified = compared.as_json(), compared.identified
    if isinstance(identified, ErrorComparison):
        found = document["identified"]
        for row, error in zip(found["errors"], identified.errors, strict=True):
            row |= {
                "position_mm": _rounded(error.one.position_mm, 1),
                "difference": _rounded(error.change, 4),
                "sigma": _rounded(error.sigma, 4),
            }
        found["field"]["planes"] = [_difference_plane(plane) for plane in identified.field.planes]
    if isinstance(compared.tables, TableDifference):
        document["tables"]["planes"] = [_difference_plane(plane) for plane in table_planes(compared.tables)]
    return document


def _difference_plane(plane: PlaneDifference) -> Document:
    return {
        "z_mm": plane.z_mm,
        "x_mm": [float(plane.x_mm[0]), float(plane.x_mm[-1])],
        "y_mm": [float(plane.y_mm[0]), float(plane.y_mm[-1])],
        "length_um": [_rounded(row, 3) for row in plane.length_um.T],
    }


def _curves(_: ReportData, identification: IdentificationData) -> Document:
    estimate = identification.estimate
    given = (estimate.model, estimate.parameters, estimate.covariance)
    return {
        "curves": [_curve(curve) for curve in geometric_error_curves(*given)],
        "cross": [_curve(curve) for curve in cross_effect_curves(*given)],
        "squareness": _squareness(identification),
    }


def _curve(curve: ErrorCurve) -> Document:
    return {
        "name": curve.name,
        "argument": curve.argument,
        "unit": curve.unit,
        "position_mm": _rounded(curve.position_mm, 1),
        "value": _rounded(curve.value, 4),
        "sigma": _rounded(curve.sigma, 4),
    }


def _squareness(identification: IdentificationData) -> list[Document]:
    estimate, sigmas = identification.estimate, identification.estimate.standard_uncertainty
    rows = []
    for name in SQUARENESSES:
        if name in estimate.model.names:
            index = estimate.model.index(name)
            value, sigma = float(estimate.parameters[index]), float(sigmas[index])
            rows.append({"name": name, "unit": "µrad", "value": 1e6 * value, "sigma": 1e6 * sigma})
    return rows


def _maps(data: ReportData, identification: IdentificationData) -> Document:
    maps = workspace_maps(
        identification.estimate, np.asarray(data.tool_offset), identification.observations.axis_positions
    )
    summary = identification.volumetric
    return {
        "deviation": [_plane(plane) for plane in maps.deviation],
        "uncertainty": [_plane(plane) for plane in maps.uncertainty],
        "before": vars(summary.before_aligned),
        "after": vars(summary.after_aligned),
    }


def _plane(plane: PlaneMap) -> Document:
    """Return the map of one plane. `length_um` has one row per y; the row contains the values at all x."""
    return {
        "z_mm": plane.z_mm,
        "x_mm": [float(plane.x_mm[0]), float(plane.x_mm[-1])],
        "y_mm": [float(plane.y_mm[0]), float(plane.y_mm[-1])],
        "length_um": [_rounded(row, 3) for row in plane.length_um.T],
        "measured": [_rounded(point, 1) for point in plane.measured],
    }


def _rounded(values: Array, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
