"""Comparison of two runs: their figures, the errors that they identified, the error field in the workspace, and the
compensation tables that they wrote. All differences are the second run minus the first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from agent.execution.journal_reader import open_journal
from agent.execution.run_record import read_record
from agent.reports.page.data import ReportedEstimate
from agent.reports.page.error_curves import SQUARENESSES, ErrorCurve, geometric_error_curves
from agent.reports.run_report import report_of
from agent.results.decision_kinds import OUTCOME
from agent.results.run_verdict import RunFigures, RunVerdict, run_figures
from agent.results.table_difference import TableDifference, table_difference
from drivers.errors import InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import align_rigidly, evaluation_grid, rigid_part, rms
from twin.units import MICRO_UNITS, UM_PER_MM

COVERAGE = 2.0
_TEXTS = {
    "no-estimate": "not both runs identified errors: {runs} did not",
    "other-travels": "the two runs have different travels of the axes",
    "no-table": "not both runs wrote a table: {runs} did not",
    "other-grids": "the two tables have different grids",
}
PLANE_SHAPE = (49, 25)
WRITTEN_ROLES = ("staged", "restored")
"""Roles of a stored table that the run wrote into the controller, in the order in which they are looked for."""


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """One of the two runs. `estimate` and `tool_offset_mm` are None if it identified no errors. `table_role` is the
    role of the `table` that it wrote, or None if it wrote none; `table` is None also for a bank without compensation.
    """

    run_id: str
    kind: str
    started: str
    verdict: RunVerdict
    figures: RunFigures
    balls: int
    machine_minutes: float
    estimate: ReportedEstimate | None
    tool_offset_mm: Array | None
    table_role: str | None
    table: TableImage | None

    def as_json(self) -> dict[str, Any]:
        figures = self.figures
        return {
            "run_id": self.run_id,
            "kind": self.kind,
            "started": self.started,
            "verdict": self.verdict.as_json(),
            "ve_um": figures.ve_um,
            "vce_um": figures.vce_um,
            "held_out_before_um": figures.held_out_before_um,
            "held_out_after_um": figures.held_out_after_um,
            "balls": self.balls,
            "machine_minutes": self.machine_minutes,
        }


@dataclass(frozen=True, eq=False)
class ErrorDifference:
    """Difference of one geometric error at n axis positions. `one` and `other` are the curves of the two runs; a
    squareness is a curve with a single point."""

    one: ErrorCurve
    other: ErrorCurve

    @property
    def change(self) -> Array:
        return self.other.value - self.one.value

    @property
    def sigma(self) -> Array:
        """Standard uncertainties (n,) of the difference of independent runs. Contributions that both runs have in
        common, such as that of the certificate of the artefact, cancel in the difference, so this is an upper bound."""
        return np.hypot(self.one.sigma, self.other.sigma)

    def as_json(self) -> dict[str, Any]:
        place = int(np.abs(self.change).argmax())
        change, doubt = float(self.change[place]), COVERAGE * float(self.sigma[place])
        return {
            "name": self.one.name,
            "unit": self.one.unit,
            "largest": change,
            "at_mm": float(self.one.position_mm[place]) if len(self.change) > 1 else None,
            "expanded_uncertainty": doubt,
            "significant": abs(change) > doubt,
        }


@dataclass(frozen=True, eq=False)
class PlaneDifference:
    """Length in µm of the difference of two fields over an XY plane at the height `z_mm`; shape (nx, ny), at the
    coordinates `x_mm` (nx,) and `y_mm` (ny,)."""

    z_mm: float
    x_mm: Array
    y_mm: Array
    length_um: Array


@dataclass(frozen=True, eq=False)
class FieldDifference:
    """Difference of the error fields of the uncompensated machine, after removal of the best-fitting rigid motion.

    `rms_um` is the volumetric rms over the evaluation grid, `largest_um` the largest length there, at `at_mm` (3,).
    """

    rms_um: float
    largest_um: float
    at_mm: Array
    planes: tuple[PlaneDifference, ...]

    def as_json(self) -> dict[str, Any]:
        return {"rms_um": self.rms_um, "largest_um": self.largest_um, "at_mm": self.at_mm.tolist()}


@dataclass(frozen=True)
class NotComparable:
    """Reason why errors or tables cannot be compared, and the identities of the runs to which it applies."""

    reason: Literal["no-estimate", "other-travels", "no-table", "other-grids"]
    run_ids: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {"reason": self.reason, "text": _TEXTS[self.reason].format(runs=" and ".join(self.run_ids))}


@dataclass(frozen=True, eq=False)
class ErrorComparison:
    """Differences of the errors that two runs identified, and of their error fields."""

    errors: tuple[ErrorDifference, ...]
    field: FieldDifference

    def as_json(self) -> dict[str, Any]:
        return {"errors": [one.as_json() for one in self.errors], "field": self.field.as_json()}


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Comparison of two runs."""

    one: ComparedRun
    other: ComparedRun
    identified: ErrorComparison | NotComparable
    tables: TableDifference | NotComparable

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as a mapping to be written as JSON; docs/reference/json.md describes the keys."""
        return {
            "runs": [self.one.as_json(), self.other.as_json()],
            "identified": self.identified.as_json(),
            "tables": self.tables.as_json(),
        }


def compare_runs(directory: Path, one_id: str, other_id: str) -> RunComparison:
    """Return the comparison of two runs of the journal in the state directory `directory`. Raise InputError if the
    journal does not have one of them."""
    return comparison_of(compared_run(directory, one_id), compared_run(directory, other_id))


def comparison_of(one: ComparedRun, other: ComparedRun) -> RunComparison:
    return RunComparison(one, other, _errors(one, other), _tables(one, other))


def compared_run(directory: Path, run_id: str) -> ComparedRun:
    """Return what is compared of a run. Raise InputError if the journal does not have the run."""
    record = read_record(directory, run_id)
    figures = run_figures(record.state, record.decision)
    verdict = figures.verdict(record.kind, record.state, ended=record.ended is not None)
    found = None if record.estimate is None else report_of(record)
    identified = None if found is None else found.identification
    role, table = _written_table(directory, run_id)
    return ComparedRun(
        run_id=run_id,
        kind=record.kind,
        started=record.started,
        verdict=verdict,
        figures=figures,
        balls=record.balls,
        machine_minutes=(record.decision(OUTCOME) or {}).get("machine_minutes", record.minutes),
        estimate=None if identified is None else identified.estimate,
        tool_offset_mm=None if found is None else np.asarray(found.tool_offset),
        table_role=role,
        table=table,
    )


def _written_table(directory: Path, run_id: str) -> tuple[str | None, TableImage | None]:
    with open_journal(directory) as reader:
        run = reader.require_run(run_id).run
        for role in WRITTEN_ROLES:
            row = reader.last_table(run, role)
            if row is not None:
                return role, reader.image(row)
    return None, None


def _errors(one: ComparedRun, other: ComparedRun) -> ErrorComparison | NotComparable:
    if one.estimate is None or other.estimate is None or other.tool_offset_mm is None:
        return NotComparable("no-estimate", tuple(run.run_id for run in (one, other) if run.estimate is None))
    if not np.array_equal(one.estimate.model.ranges_mm, other.estimate.model.ranges_mm):
        return NotComparable("other-travels")
    former, now = _by_name(one.estimate), _by_name(other.estimate)
    errors = tuple(ErrorDifference(curve, now[name]) for name, curve in former.items() if name in now)
    return ErrorComparison(errors, _field(one.estimate, other.estimate, other.tool_offset_mm))


def _by_name(estimate: ReportedEstimate) -> dict[str, ErrorCurve]:
    """Return the curves of the error motions and the squarenesses of an estimate by their names."""
    curves = geometric_error_curves(estimate.model, estimate.parameters, estimate.covariance)
    found = {curve.name: curve for curve in curves}
    unit, scale = MICRO_UNITS["rad"]
    for name in SQUARENESSES:
        if name in estimate.model.names:
            index = estimate.model.index(name)
            value, sigma = estimate.parameters[index], estimate.standard_uncertainty[index]
            variance = np.array([[(scale * sigma) ** 2]])
            found[name] = ErrorCurve(name, "", unit, np.zeros(1), np.array([scale * value]), variance)
    return found


def _field(one: ReportedEstimate, other: ReportedEstimate, tool_offset_mm: Array) -> FieldDifference:
    ranges = one.model.ranges_mm

    def change(points: Array) -> Array:
        former, now = (exact_deviation(each.model, points, tool_offset_mm, each.parameters) for each in (one, other))
        return now - former

    grid = evaluation_grid(ranges)
    everywhere = change(grid)
    left = align_rigidly(grid + tool_offset_mm, everywhere)
    lengths = np.linalg.norm(left, axis=1)
    x, y = (np.linspace(*limits, count) for limits, count in zip(ranges[:2], PLANE_SHAPE, strict=True))
    planes = []
    for height in np.linspace(*ranges[2], 3):
        points = np.stack(np.meshgrid(x, y, [height], indexing="ij"), axis=-1).reshape(-1, 3)
        there = change(points) - rigid_part(grid + tool_offset_mm, everywhere, points + tool_offset_mm)
        planes.append(
            PlaneDifference(float(height), x, y, UM_PER_MM * np.linalg.norm(there, axis=1).reshape(PLANE_SHAPE))
        )
    worst = int(lengths.argmax())
    return FieldDifference(UM_PER_MM * rms(left), UM_PER_MM * float(lengths[worst]), grid[worst], tuple(planes))


def _tables(one: ComparedRun, other: ComparedRun) -> TableDifference | NotComparable:
    without = tuple(run.run_id for run in (one, other) if run.table_role is None)
    if without:
        return NotComparable("no-table", without)
    try:
        return table_difference(one.table, other.table)
    except InputError:
        return NotComparable("other-grids")


def table_planes(difference: TableDifference) -> tuple[PlaneDifference, ...]:
    """Return the length of the change of the correction at the lowest, the middle and the highest nodes along Z."""
    x, y, z = difference.nodes_mm
    lengths = np.linalg.norm(difference.change_um, axis=-1)
    levels = sorted({0, len(z) // 2, len(z) - 1}) if len(z) else []
    return tuple(PlaneDifference(float(z[level]), x, y, lengths[..., level]) for level in levels)
