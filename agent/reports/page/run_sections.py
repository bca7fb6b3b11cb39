"""Sections of the report about a run on a machine: verification, nightly run, gates, questions to the operator, inputs
and events."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from agent.reports.page.data import NightFacts, Provenance, ReportData, VerificationFacts
from agent.reports.page.number_format import Table, fixed, micrometres, number
from agent.reports.page.run_figures import draw_verification
from agent.reports.page.texts import Texts
from agent.results.facts import ArtefactFacts
from agent.results.gates.gate_rules import GATE_RULES
from twin.arrays import Array


def verification(proof: VerificationFacts | None, t: Texts) -> dict[str, Any] | None:
    if proof is None:
        return None
    rows = (
        (t["held_out_before"], micrometres(proof.before)),
        (t["held_out_after"], micrometres(proof.after)),
        (t["held_out_predicted"], f"{number(proof.predicted_um, 3)} µm"),
        (t["held_out_choice"], t["held_out_least_known" if proof.least_known else "held_out_listed"]),
    )
    figure = Markup(draw_verification(proof.positions)) if proof.positions else ""  # noqa: S704  drawn by ourselves
    table = Table((t["held_out_head"], t["value"]), rows, (t["value"],))
    return {"accepted": proof.accepted, "verdict": proof.verdict, "table": table, "figure": figure}


def night(facts: NightFacts | None, t: Texts) -> dict[str, Any] | None:
    if facts is None:
        return None
    note = t["night_note"].format(since=facts.since)
    return {"decision": facts.decision, "good": facts.good, "rows": facts.rows, "note": note}


def temperature_note(artefact: ArtefactFacts, temperature_c: Array) -> str:
    expansion = (
        f"expansion compensated with {1e6 * artefact.cte_per_k:.2f} ± "
        f"{2e6 * artefact.cte_standard_uncertainty_per_k:.2f} µm/(m·K) (k = 2)."
    )
    if not len(temperature_c):
        return f"Reference {artefact.reference_temperature_c:g} °C; {expansion}"
    low, high = float(np.min(temperature_c)), float(np.max(temperature_c))
    return (
        f"Artefact between {low:.2f} and {high:.2f} °C (reference {artefact.reference_temperature_c:g} °C); {expansion}"
    )


def gates(data: ReportData) -> list[dict[str, Any]]:
    return [
        {
            "name": GATE_RULES[gate.name].title,
            "text": gate.text,
            "value": number(gate.value, 3),
            "limit": "none" if np.isinf(gate.limit) else f"{GATE_RULES[gate.name].sign} {number(gate.limit, 3)}",
            "passed": gate.passed,
        }
        for gate in data.gates
    ]


def consents(data: ReportData, t: Texts) -> Table | None:
    if not data.run.questions:
        return None
    answers = {True: t["yes"], None: t["open"]}
    rows = tuple(
        (fixed(one.minute, 1), one.text, answers.get(one.yes, t["no"].format(error=one.error)))
        for one in data.run.questions
    )
    return Table((t["minute"], t["asked"], t["answer"]), rows, (t["minute"],))


def inputs(provenance: Provenance | None, t: Texts) -> Table | None:
    if provenance is None:
        return None
    rows = (*provenance.files, ("complete settings as recorded in the journal", provenance.settings_sha256))
    return Table((t["file"], t["digest"]), rows, (), (t["digest"],))


def events(data: ReportData, t: Texts) -> Table | None:
    if not data.run.events:
        return None
    rows = tuple((event.timestamp.replace("T", " ")[:19], event.kind, event.text) for event in data.run.events)
    return Table((t["time"], t["kind"], t["event"]), rows, code=(t["time"],))
