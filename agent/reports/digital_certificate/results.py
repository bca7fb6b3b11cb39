"""Results of a certificate: volumetric errors, the 21 geometric errors, and the predicted figures of ISO 230."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from lxml import etree

from agent.reports.digital_certificate.administration import (
    NAMESPACE,
    add_equipment,
    was_measured,
)
from agent.reports.digital_certificate.elements import add, add_real, add_software, add_words
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.document_head import method, standards
from agent.reports.page.error_table import ErrorRow, error_rows
from agent.reports.page.number_format import COVERAGE, fixed
from agent.reports.page.texts import Texts
from agent.results.facts import Quantity
from twin.compensation.table import CompensationTable
from twin.machine.error_model import SQUARENESS
from twin.units import UM_PER_MM
from twin.workpiece.acceptance import PredictedTest
from twin.workpiece.conformity import Conformity, decide_by_limits
from twin.workpiece.features import Measure
from twin.workpiece.prediction import FeatureError

_STATED = {Conformity.CONFORMS: "pass", Conformity.DOES_NOT_CONFORM: "fail"}
_NORM = re.compile(r"^([A-Z][A-Z/]+ [0-9-]+)")


def add_results(
    root: etree._Element, data: ReportData, found: IdentificationData, table: CompensationTable | None, t: Texts
) -> None:
    """Add the results of an estimate. `table` is the compensation table that the run wrote; None if it wrote none."""
    results = add(root, "measurementResults")
    measured = add(results, "measurementResult")
    add_words(measured, "name", "Volumetric calibration of the machine")
    _add_methods(measured, data, t)
    add_software(add(measured, "usedSoftware"), data.header.software_version)
    add_equipment(measured, data, t)
    if was_measured(found):
        _add_conditions(measured, found)
    listed = add(measured, "results")
    _add_volumetric(listed, data, found, t)
    _add_geometric(listed, found, data.tolerances, t)
    _add_acceptance(listed, found, table, t)


def _add_methods(measured: etree._Element, data: ReportData, t: Texts) -> None:
    one = add(add(measured, "usedMethods"), "usedMethod")
    add_words(one, "name", "On-machine volumetric calibration with a ball artefact")
    add_words(one, "description", *method(data, t), *standards(data, t))
    for text in standards(data, t):
        norm = _NORM.match(text)
        if norm is not None:
            add(one, "norm", norm[1])


def _add_conditions(measured: etree._Element, found: IdentificationData) -> None:
    """Add the lowest and the highest temperature of the artefact."""
    conditions = add(measured, "influenceConditions")
    one = add(conditions, "influenceCondition", refType="basic_temperature")
    add_words(one, "name", "Temperature of the artefact")
    read = found.observations.temperature_c
    data = add(one, "data")
    for reference, value in (("basic_temperatureMin", read.min()), ("basic_temperatureMax", read.max())):
        add_real(add(data, "quantity", refType=reference), float(value), "°C")


def _add_result(listed: etree._Element, name: str, *sentences: str) -> etree._Element:
    """Add a result and return the element of its data."""
    result = add(listed, "result")
    add_words(result, "name", name)
    if sentences:
        add_words(result, "description", *sentences)
    return add(result, "data")


def _add_volumetric(listed: etree._Element, data: ReportData, found: IdentificationData, t: Texts) -> None:
    proof, summary, active = data.run.verification, found.volumetric, data.new_table_active
    values = _add_result(
        listed,
        "Volumetric errors",
        "Root mean square of the error vector over the workspace, after removal of the best-fitting rigid motion.",
        "The compensation table was active after the run."
        if active
        else "Values with the compensation table are predicted: the table was not active after the run.",
    )
    _add_quantity(
        values, "volumetricError", t["tile_before"], summary.before_aligned, tolerance=data.tolerances.get("VE")
    )
    _add_quantity(
        values,
        "volumetricCompensatedError",
        t["tile_after"],
        summary.after_aligned,
        tolerance=data.tolerances.get("VCE") if active else None,
    )
    if proof is not None:
        _add_quantity(values, "heldOutResidual", t["tile_held_out"], proof.after)


def _add_quantity(
    data: etree._Element, kind: str, name: str, quantity: Quantity, tolerance: float | None = None
) -> None:
    """Add a quantity in µm. A tolerance is compared with its 95 % limits."""
    one = add(data, "quantity", refType=f"basic_measuredValue {NAMESPACE}_{kind}")
    add_words(one, "name", name)
    doubt = quantity.standard_uncertainty_um
    expanded = None if doubt is None else COVERAGE * doubt
    add_real(one, quantity.value_um, "µm", expanded, quantity, is_normal=False)
    if tolerance is not None:
        half = expanded or 0.0
        lower, upper = quantity.limits_um or (quantity.value_um - half, quantity.value_um + half)
        _add_conformity(one, decide_by_limits(lower, upper, tolerance), tolerance, "µm")


def _add_conformity(quantity: etree._Element, stated: Conformity, tolerance: float, unit: str) -> None:
    """Add what may be stated about a tolerance. Nothing but a sentence is added if that is nothing."""
    one = add(add(quantity, "measurementMetaData"), "metaData", refType="basic_conformity")
    add(one, "norm", "ISO 14253-1")
    if stated not in _STATED:
        add_words(
            one, "declaration", "The tolerance lies within the uncertainty: no statement of conformity is possible."
        )
    else:
        add(one, "conformity", _STATED[stated])
    limit = add(add(one, "data"), "quantity", refType=f"{NAMESPACE}_tolerance")
    add_real(limit, tolerance, unit)


def _add_geometric(
    listed: etree._Element, found: IdentificationData, tolerances: Mapping[str, float], t: Texts
) -> None:
    values = _add_result(
        listed,
        t["errors"],
        "Names and signs after ISO 230-1: range of each error motion over the travel, and value of each squareness, of "
        "the machine without compensation.",
    )
    whole = add(values, "list")
    add_words(whole, "name", t["errors"])
    for row in error_rows(found):
        _add_error(whole, row, tolerances.get(row.name))


def _add_error(whole: etree._Element, row: ErrorRow, tolerance: float | None) -> None:
    kind = "squareness" if row.name in SQUARENESS else "errorMotionRange"
    one = add(whole, "quantity", refType=f"basic_measuredValue {NAMESPACE}_{kind} iso230-1_{row.name}")
    add_words(one, "name", f"{row.name}; {row.meaning}")
    if row.waves > 0.0:
        size = f"{fixed(row.waves, 1)} {row.unit}"
        add_words(
            one,
            "description",
            f"Waves too short for the error model may change the range by up to {size}.",
        )
    add_real(one, row.size, row.unit, row.expanded_uncertainty, is_normal=row.name in SQUARENESS)
    if tolerance is not None:
        _add_conformity(one, row.conformity(tolerance), tolerance, row.unit)


def _add_acceptance(
    listed: etree._Element, found: IdentificationData, table: CompensationTable | None, t: Texts
) -> None:
    """Add the predicted figures of acceptance tests that the report contains, without the table and with it."""
    if found.acceptance is None:
        return
    states = {"without_table": "Predicted figures of ISO 230, without compensation table"}
    if table is not None:
        states["with_table"] = "Predicted figures of ISO 230, with compensation table"
    for state, title in states.items():
        values = _add_result(listed, title, t["not_an_acceptance_test"], t["acceptance_note"])
        whole = add(values, "list")
        add_words(whole, "name", title)
        _add_figures(whole, found.acceptance.all_tests, state)


def _add_figures(whole: etree._Element, tests: Sequence[PredictedTest], state: str) -> None:
    for one in tests:
        error: FeatureError | None = getattr(one.figure, state)
        if error is None:
            continue
        kind = re.sub(r"[^A-Za-z0-9+-]+", "_", f"{one.test.standard}_{one.test.feature.name}")
        quantity = add(whole, "quantity", refType=f"{NAMESPACE}_acceptanceFigure {NAMESPACE}_{kind}")
        add_words(quantity, "name", f"{one.test.standard}; {one.test.title}")
        value, low, high, expanded = (
            UM_PER_MM * part for part in (error.expected_mm, error.low_mm, error.high_mm, error.expanded_mm)
        )
        # as in the report: a range, which cannot be negative, has 95 % limits
        ranged = one.test.feature.measure is not Measure.SIGNED
        add_real(quantity, value, "µm", expanded, Quantity(value, expanded / COVERAGE, (low, high)) if ranged else None)
