"""Rendering of the report as one self-contained page with figures and style."""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup

from agent.html_templates import html_template
from agent.language.sentences import Language
from agent.reports.page import document_head, error_table, identification_sections, run_sections
from agent.reports.page.budget_table import budget_table
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.figures import report_figures
from agent.reports.page.german import page_in_language
from agent.reports.page.identity import identity, tiles, validity
from agent.reports.page.number_format import plural
from agent.reports.page.texts import ENGLISH, Texts
from agent.results.run_verdict import Look

GOOD_STATES = ("complete", "idle", "held")
"""States of a report that belongs to no run."""
GOOD_LOOKS = (Look.GOOD, Look.NEUTRAL)


def render_report(data: ReportData, texts: Texts = ENGLISH, language: Language = "en") -> str:
    """Return the HTML text of the whole report. Equal data always give equal bytes. Rendering takes a few seconds at
    most."""
    return page_in_language(_english(data, texts), language)


def _english(data: ReportData, texts: Texts) -> str:
    style = resources.files("agent.reports.page").joinpath("report.css").read_text(encoding="utf-8")
    figures = {name: Markup(svg) for name, svg in report_figures(data).items()}  # noqa: S704  drawn by ourselves
    return html_template("agent.reports.page", "report.html").render(
        css=Markup(style),  # noqa: S704  a file of this package
        **page_values(data, texts),
        **figures,
    )


def page_values(data: ReportData, t: Texts) -> dict[str, Any]:
    """Return all values that the template uses, except the figures."""
    failed = [gate for gate in data.gates if not gate.passed]
    proof, night, header = data.run.verification, data.run.night, data.header
    verdict, state = header.verdict, header.end
    good = header.state in GOOD_STATES if verdict is None else verdict.look in GOOD_LOOKS
    good = good and not failed and (proof is None or proof.accepted)
    if failed:
        state = t["gates_failed"].format(state=state, gates=plural(len(failed), "gate"))
    return {
        "t": t,
        "header": header,
        "machine": data.machine,
        "date": header.timestamp.replace("T", " ")[:16] + " UTC",
        "state": state,
        "good": good and (night is None or night.good),
        "sentence": "" if verdict is None else verdict.sentence["en"],
        "reason": data.run.reason,
        "tiles": tiles(data, t),
        "number": document_head.report_number(data),
        "head": document_head.document_head(data, t),
        "instruments": document_head.instruments(data, t),
        "method": document_head.method(data, t),
        "standards": document_head.standards(data, t),
        "identity": identity(data),
        "warnings": (*document_head.calibration_notes(data, t), *data.warnings),
        "verification": run_sections.verification(proof, t),
        "night": run_sections.night(night, t),
        "probe": data.run.probe.rows if data.run.probe else (),
        "temperature_note": run_sections.temperature_note(data.artefact, _temperatures(data)),
        "gates": run_sections.gates(data),
        "consents": run_sections.consents(data, t),
        "inputs": run_sections.inputs(data.run.provenance, t),
        "events": run_sections.events(data, t),
        "signatures": document_head.signatures(data.document, t),
        "identification": None if data.identification is None else _identification(data, data.identification, t),
    }


def _identification(data: ReportData, identification: IdentificationData, t: Texts) -> dict[str, Any]:
    """Return the values of the sections that need an estimate."""
    predicted = identification.acceptance
    return {
        "summary": identification_sections.summary_table(data, identification, t),
        "travel": identification_sections.travel_table(identification, t),
        "limits": error_table.volumetric_conformity(
            identification, data.tolerances, t, table_active=data.new_table_active
        ),
        "errors": error_table.error_tables(identification, data.tolerances, t),
        "limited": bool(data.tolerances),
        "withheld": data.withholds_conformity,
        "budget": budget_table(identification, np.asarray(data.tool_offset), t),
        "acceptance": None if predicted is None else error_table.acceptance_table(predicted, t),
        "not_measured": () if predicted is None else predicted.not_measured,
        "validity": validity(data, identification),
        "residual_note": identification_sections.residual_note(identification),
        "rejected": identification_sections.rejected(identification),
        "fit": identification_sections.fit(identification),
        "joined": identification_sections.joined_instruments(identification.estimate.instruments),
        "calibration": identification_sections.artefact_calibration(identification.estimate.artefact_calibration),
        "null_intro": identification_sections.null_intro(identification),
        "null_directions": identification.estimate.null_summary,
        "table": identification_sections.table_rows(identification),
        "parameters": identification_sections.parameters(identification),
    }


def _temperatures(data: ReportData) -> np.ndarray:
    """Return all measured temperatures of the artefact in °C."""
    if data.identification is not None:
        return data.identification.observations.temperature_c
    traces = [trace.temperature_c for trace in data.run.temperatures if trace.name == "artefact"]
    return np.concatenate(traces) if traces else np.empty(0)
