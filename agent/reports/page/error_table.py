"""Tables of the 21 geometric errors (range over the travel, expanded uncertainty, tolerance and what may be stated
about conformity) and of the predicted figures of acceptance tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.reports.page.data import IdentificationData, ReportedEstimate
from agent.reports.page.error_curves import SAMPLES, geometric_error_curves
from agent.reports.page.number_format import COVERAGE, Table, fixed
from agent.reports.page.texts import Texts
from agent.results.facts import Quantity
from agent.workpiece.predicted_tests import PredictedTests
from twin.machine.error_model import ERROR_MOTIONS, SQUARENESS, error_motion_kind
from twin.machine.kinematic_chain import AXES
from twin.units import MICRO_UNITS, UM_PER_MM
from twin.workpiece.conformity import Conformity, decide_by_limits
from twin.workpiece.features import Measure
from twin.workpiece.prediction import FeatureError

_ROLLS = ("EAX", "EBY", "ECZ")
_SQUARENESS_OF = {"C0Y": "squareness of Y to X", "B0Z": "squareness of Z to X", "A0Z": "squareness of Z to Y"}


@dataclass(frozen=True)
class ErrorRow:
    """One of the 21 geometric errors. `size` is the range of an error motion over the travel, or the value of a
    squareness, and `expanded_uncertainty` its U (k = 2), both in `unit`, which is µm or µrad.

    `waves` is what waves that are too short for the error model may add to the range, or take from it, in `unit`. They
    are in neither of the two.
    """

    name: str
    meaning: str
    unit: str
    size: float
    expanded_uncertainty: float
    waves: float = 0.0

    def conformity(self, tolerance: float | None) -> Conformity:
        """Return what may be stated about the error and its tolerance after ISO 14253-1, with a guard band of U and of
        the short waves."""
        size, doubt = abs(self.size), self.expanded_uncertainty + self.waves
        return decide_by_limits(size - doubt, size + doubt, tolerance)


def error_rows(identification: IdentificationData) -> tuple[ErrorRow, ...]:
    """Return the geometric errors that the error model contains: the error motions of X, Y and Z, then the
    squarenesses."""
    estimate = identification.estimate
    model, sigma = estimate.model, estimate.standard_uncertainty
    curves = geometric_error_curves(model, estimate.parameters, estimate.covariance)
    rows = [ErrorRow(one.name, meaning(one.name), one.unit, *one.range, _waves(estimate, one.name)) for one in curves]
    for name in SQUARENESS:
        if name in model.names:
            index = model.index(name)
            unit, scale = MICRO_UNITS["rad"]
            value, doubt = scale * float(estimate.parameters[index]), COVERAGE * scale * float(sigma[index])
            rows.append(ErrorRow(name, meaning(name), unit, value, doubt))
    return tuple(rows)


def _waves(estimate: ReportedEstimate, name: str) -> float:
    """Return what the misfit may add to the range of a positioning or straightness error in µm: its range on the line
    through the middle of the travel, and its U (k = 2). It is 0 for tilts and rolls, which the misfit does not have."""
    misfit = estimate.misfit
    if misfit is None or name[1] not in AXES:
        return 0.0
    component, axis = AXES.index(name[1]), AXES.index(name[2])
    ranges = np.array(estimate.model.ranges_mm)
    line = np.tile(ranges.mean(axis=1), (SAMPLES, 1))
    line[:, axis] = np.linspace(*estimate.model.ranges_mm[axis], SAMPLES)
    modes = misfit.amplitude_mm * misfit.modes.at(line)[:, component]
    variances = np.sum((modes @ misfit.covariance) * modes, axis=1) + estimate.scatter_mm2
    doubt_mm = COVERAGE * math.sqrt(2.0 * float(variances.max()))
    return UM_PER_MM * (float(np.ptp(modes @ misfit.coefficients)) + doubt_mm)


def meaning(name: str) -> str:
    """Return what the error `name` of ISO 230-1 is, such as `straightness of X in Y`."""
    if name in _SQUARENESS_OF:
        return _SQUARENESS_OF[name]
    direction, axis = name[1], name[2]
    kind = error_motion_kind(name)
    if kind == "positioning":
        return f"positioning of {axis}"
    if kind == "straightness":
        return f"straightness of {axis} in {direction}"
    about = AXES["ABC".index(direction)]
    return f"roll of {axis}" if name in _ROLLS else f"tilt of {axis} about {about}"


def error_tables(identification: IdentificationData, tolerances: Mapping[str, float], t: Texts) -> list[Table]:
    """Return the geometric errors in two tables, which stand side by side: those of X with the squarenesses, and the
    others. Columns of tolerances are left out if no tolerance of a geometric error is stated."""
    rows = error_rows(identification)
    limited = any(name in tolerances for name in (*ERROR_MOTIONS, *SQUARENESS))
    cells = [_cells(row, tolerances.get(row.name), t, limited=limited) for row in rows]
    known = {row.name for row in rows}
    for name in sorted(tolerances.keys() & (set(ERROR_MOTIONS) | set(SQUARENESS)) - known):
        unit = "µrad" if name in SQUARENESS or name[1] not in AXES else "µm"
        cells.append((name, meaning(name), "–", "–", unit, f"{tolerances[name]:g}", t["not_determined"]))
    heads = (t["error"], t["meaning"], t["size"], t["expanded"], t["unit"])
    numeric = (t["size"], t["expanded"])
    if limited:
        wider = (*heads, t["tolerance"], t["conformity"])
        return [Table(wider, tuple(cells), (*numeric, t["tolerance"]))]
    half = (len(cells) + 1) // 2
    return [Table(heads, tuple(part), numeric) for part in (cells[:half], cells[half:]) if part]


def _cells(row: ErrorRow, tolerance: float | None, t: Texts, *, limited: bool) -> tuple[str, ...]:
    first = (row.name, row.meaning, fixed(row.size, 1), fixed(row.expanded_uncertainty, 1), row.unit)
    if not limited:
        return first
    if tolerance is None:
        return (*first, "–", "–")
    return (*first, f"{tolerance:g}", t[row.conformity(tolerance).name.lower()])


def volumetric_conformity(
    identification: IdentificationData, tolerances: Mapping[str, float], t: Texts, *, table_active: bool
) -> Table | None:
    """Return the table of the volumetric errors that have a tolerance, or None if none has one. A 95 % limit beyond the
    tolerance forbids the statement of conformity. Nothing is stated about the VCE with a new table that is not active
    (`table_active`) after the run."""
    summary = identification.volumetric
    rows = []
    for name, quantity in (("VE", summary.before_aligned), ("VCE", summary.after_aligned)):
        if name in tolerances:
            lower, upper = _limits(quantity)
            stated = decide_by_limits(lower, upper, tolerances[name])
            values = (fixed(quantity.value_um, 1), fixed(lower, 1), fixed(upper, 1), f"{tolerances[name]:g}")
            told = t["table_not_active"] if name == "VCE" and not table_active else t[stated.name.lower()]
            rows.append((t[f"tolerated_{name.lower()}"], *values, told))
    if not rows:
        return None
    heads = (t["quantity"], t["value_um"], t["lower"], t["upper"], t["tolerance"], t["conformity"])
    return Table(heads, tuple(rows), heads[1:5])


def _limits(quantity: Quantity) -> tuple[float, float]:
    if quantity.limits_um is not None:
        return quantity.limits_um
    doubt = COVERAGE * (quantity.standard_uncertainty_um or 0.0)
    return quantity.value_um - doubt, quantity.value_um + doubt


def acceptance_table(predicted: PredictedTests, t: Texts) -> Table:
    """Return one row for each figure, in µm, with U (k = 2) or the 95 % limits of a range. The columns of a machine
    with its table are left out if no table was predicted."""
    states = ["without"] if predicted.table is None else ["without", "with"]
    columns = [t[f"{name}_{state}"] for state in states for name in ("value", "limits")]
    heads = (t["figure"], t["meaning"], t["standard"], *columns)
    rows = []
    for one in predicted.all_tests:
        errors = (one.figure.without_table, one.figure.with_table)[: len(states)]
        cells = [
            cell for error in errors if error is not None for cell in _figure_cells(one.test.feature.measure, error)
        ]
        rows.append((one.test.feature.name, one.test.title, one.test.standard, *cells))
    return Table(heads, tuple(rows), heads[3:], code=(t["standard"],))


def _figure_cells(measure: Measure, error: FeatureError) -> tuple[str, str]:
    value, low, high, doubt = (
        fixed(UM_PER_MM * one, 1) for one in (error.expected_mm, error.low_mm, error.high_mm, error.expanded_mm)
    )
    return value, f"± {doubt}" if measure is Measure.SIGNED else f"{low} … {high}"
