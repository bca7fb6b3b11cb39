"""Results of a run as numbers for figures. They comprise the geometric errors with their uncertainty bands, and maps of
the deviation in the workspace."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import BoundedSemaphore, Lock
from typing import Any, TypeVar

import numpy as np

from agent.execution.run_record import read_record
from agent.reports.page import IdentificationData, ReportData
from agent.reports.page.error_curves import SQUARENESSES, ErrorCurve, cross_effect_curves, geometric_error_curves
from agent.reports.page.error_field import ErrorField, FieldPlane
from agent.reports.run_comparison import ErrorComparison, PlaneDifference, RunComparison, table_planes
from agent.reports.run_report import report_of
from agent.results.table_difference import TableDifference
from agent.results.table_image import table_of
from agent.runs.kinds.restoration import stored_table
from drivers.errors import InputError
from twin.arrays import Array
from twin.machine.kinematic_chain import AXES

Document = dict[str, Any]
K = TypeVar("K")
V = TypeVar("V")
MAX_CACHED = 16
MAX_FIELDS = 4
MAX_COMPUTED_AT_ONCE = 2
"""Number of runs whose results are computed at the same time. Further ones wait, so that requests for many runs neither
take all processors from a run in progress nor fill the memory."""


class RunLocks:
    """One lock for each run that is in use, so that a slow result of one run delays only those who ask for this run.

    A lock is kept no longer than somebody holds it or waits for it.
    """

    def __init__(self) -> None:
        self._guard = Lock()
        self._locks: dict[tuple[str, str], Lock] = {}
        self._users: Counter[tuple[str, str]] = Counter()

    @contextmanager
    def locked(self, directory: Path, run_id: str) -> Iterator[None]:
        """Hold the lock of a run during the `with` block."""
        key = (str(directory), run_id)
        with self._guard:
            self._users[key] += 1
            lock = self._locks.setdefault(key, Lock())
        try:
            with lock:
                yield
        finally:
            with self._guard:
                self._users[key] -= 1
                if not self._users[key]:
                    del self._users[key], self._locks[key]

    def __len__(self) -> int:
        return len(self._locks)


class ResultCache:
    """Cache of the results of the runs that were requested last. It is safe to use from any thread.

    Each result is computed under the lock of its run, and the lock of the cache is held only to look up and to store.
    At most MAX_COMPUTED_AT_ONCE results are computed at the same time.
    """

    def __init__(self) -> None:
        self.run_locks = RunLocks()
        self._lock = Lock()
        self._computing = BoundedSemaphore(MAX_COMPUTED_AT_ONCE)
        self._cached: dict[tuple[str, str, str], Document] = {}
        self._fields: dict[tuple[str, str], tuple[IdentificationData, ErrorField]] = {}

    def curves(self, directory: Path, run_id: str) -> Document:
        """Return the curves of the geometric errors of a run. Raise InputError if the run has no estimate."""
        return self._of("curves", directory, run_id, _curves)

    def plane(self, directory: Path, run_id: str, normal: str, at_mm: float | None) -> Document:
        """Return the error field on a plane, without and with the table of the run. `normal` is the axis X, Y or Z, and
        `at_mm` the position on it, by default the middle of the travel. Raise InputError if the run has no estimate.
        """
        axis = AXES.index(normal.upper())
        # a field computes its parts when they are first asked for
        with self.run_locks.locked(directory, run_id), self._computing:
            identification, field = self._field_of(directory, run_id)
            low, high = field.ranges_mm[axis]
            plane = field.plane(axis, (low + high) / 2 if at_mm is None else at_mm)
            largest_um = field.largest_um
        summary = identification.volumetric
        return {
            **_plane_document(plane, field),
            "largest_um": largest_um,
            "before": vars(summary.before_aligned),
            "after": vars(summary.after_aligned),
        }

    def _field_of(self, directory: Path, run_id: str) -> tuple[IdentificationData, ErrorField]:
        """Return the error field of a run, whose lock is held, from the cache or anew."""
        key = (str(directory), run_id)
        with self._lock:
            if key in self._fields:
                return self._fields[key]
        record = read_record(directory, run_id)
        data = report_of(record)
        identified = _identified(data, run_id)
        offset = np.asarray(data.tool_offset)
        image = None if record.table("staged") is None else stored_table(directory, run_id, "staged")
        table = None if image is None else table_of(image, offset)
        made = identified, ErrorField(identified.estimate, offset, identified.observations.axis_positions, table)
        if record.ended is not None:
            self._keep(self._fields, key, made, MAX_FIELDS)
        return made

    def _of(
        self, what: str, directory: Path, run_id: str, make: Callable[[ReportData, IdentificationData], Document]
    ) -> Document:
        """Return document `what` of a run from the cache. If it is not cached, make it with `make`.

        The document of a run in progress is not cached, since the estimate of that run may still change.
        """
        key = (what, str(directory), run_id)
        with self.run_locks.locked(directory, run_id):
            with self._lock:
                if key in self._cached:
                    return self._cached[key]
            with self._computing:
                record = read_record(directory, run_id)
                data = report_of(record)
                document = make(data, _identified(data, run_id))
            if record.ended is not None:
                self._keep(self._cached, key, document, MAX_CACHED)
            return document

    def _keep(self, kept: dict[K, V], key: K, value: V, most: int) -> None:
        """Store a result, and drop the oldest ones above `most`."""
        with self._lock:
            kept[key] = value
            while len(kept) > most:
                kept.pop(next(iter(kept)))


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


def _plane_document(plane: FieldPlane, field: ErrorField) -> Document:
    """Return a plane of the error field. Each list of rows has one row per position along the second axis of `across`;
    a row contains the values at all positions along the first one."""

    def rows(values: Array) -> list[Any]:
        found: list[Any] = np.round(values.swapaxes(0, 1), 2).tolist()
        return found

    return {
        "normal": AXES[plane.normal],
        "at_mm": plane.at_mm,
        "across": [AXES[axis] for axis in plane.across],
        "ranges_mm": dict(zip(AXES, field.ranges_mm, strict=True)),
        "without_um": rows(plane.without_um),
        "with_um": None if plane.with_um is None else rows(plane.with_um),
        "sigma_um": rows(plane.sigma_um),
        "measured": [_rounded(point, 1) for point in plane.measured],
    }


def _identified(data: ReportData, run_id: str) -> IdentificationData:
    if data.identification is None:
        raise InputError(f"run {run_id} has no estimate", hint="the run ended before the errors were identified")
    return data.identification


def _rounded(values: Array, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
