"""Head of the document: number, customer, machine, place, people, instruments, method and standards, and signatures.

What the settings do not state is shown as not stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date

from agent.language.sentences import as_it_is
from agent.reports.page.data import ReportData
from agent.reports.page.number_format import Rows, Table
from agent.reports.page.texts import Texts
from agent.settings.report import Instrument, InstrumentKind, ReportSettings

EXPECTED: tuple[InstrumentKind, ...] = ("probe", "artefact", "thermometer")
"""Kinds of instruments that every run uses."""
_KINDS: tuple[InstrumentKind, ...] = ("probe", "sensor", "artefact", "thermometer", "other")


def report_number(data: ReportData) -> str:
    """Return the prefix that the settings state, followed by the identity of the run."""
    return as_it_is(f"{data.document.number_prefix or ''}{data.header.run_id}")


def document_head(data: ReportData, t: Texts) -> Rows:
    """Return the name and the text of each row of the head."""
    stated, machine = data.document, data.document.machine
    return [
        (t["report_number"], report_number(data)),
        (t["customer"], _words(stated.customer, t)),
        (t["machine_maker"], _words(machine.maker, t)),
        (t["machine_model"], _words(machine.model, t)),
        (t["machine_serial"], _words(machine.serial_number, t)),
        (t["place"], _words(stated.place, t)),
        (t["operator"], _words(stated.operator, t)),
        *((name, text) for name, text in data.run.times if name == "Started"),
    ]


def _words(text: str | None, t: Texts) -> str:
    return t["not_stated"] if text is None else as_it_is(text)


def instruments(data: ReportData, t: Texts) -> Table:
    """Return the table of the instruments. The artefact is named by its file if the settings do not name it."""
    listed = listed_instruments(data)
    rows = tuple(
        (
            t[f"instrument_{one.kind}"],
            _words(one.name, t),
            _words(one.serial_number, t),
            _words(one.certificate, t),
            _date(one.calibrated, t),
            _date(one.due, t),
        )
        for one in listed
    )
    heads = tuple(t[name] for name in ("instrument", "name", "serial_number", "certificate", "calibrated", "due"))
    return Table(heads, rows, code=heads[4:])


def listed_instruments(data: ReportData) -> tuple[Instrument, ...]:
    """Return the instruments that the settings state, by kind, and an empty one of each kind that is missing there.

    Name and certificate of the artefact of the run are those of its file if the settings do not state them.
    """
    stated = data.document.instruments
    kinds = {one.kind for one in stated}
    missing = [Instrument(kind=kind) for kind in EXPECTED if kind not in kinds]
    artefact = data.artefact
    named = [
        one.model_copy(
            update={"name": one.name or artefact.name, "certificate": one.certificate or artefact.certificate}
        )
        if one.kind == "artefact" and one.name in (None, artefact.name)
        else one
        for one in (*stated, *missing)
    ]
    return tuple(sorted(named, key=lambda one: _KINDS.index(one.kind)))


def _date(day: date | None, t: Texts) -> str:
    return t["not_stated"] if day is None else day.isoformat()


def calibration_notes(data: ReportData, t: Texts) -> tuple[str, ...]:
    """Return a sentence for each instrument whose calibration was due before the day of the measurement, or is dated
    after it."""
    measured = date.fromisoformat(data.header.timestamp[:10])
    notes = []
    for one in data.document.instruments:
        said = ", ".join(part for part in (one.name, one.serial_number, one.certificate) if part is not None) or "–"
        places = {"instrument": t[f"instrument_{one.kind}"], "said": said, "measured": measured}
        if one.due is not None and one.due < measured:
            notes.append(t["calibration_overdue"].format(due=one.due, **places))
        if one.calibrated is not None and one.calibrated > measured:
            notes.append(t["calibrated_later"].format(day=one.calibrated, **places))
    return tuple(notes)


def method(data: ReportData, t: Texts) -> list[str]:
    """Return the sentences on the method of the measurement and of its evaluation."""
    sentences = [t["method_measured"]]
    found = data.identification
    if found is not None:
        sentences.append(t["method_identified"])
        sentences += [t["method_weights"]] * (dict(data.header.settings).get("Weights") == "full covariances")
        sentences += [t["method_family"]] * (dict(data.header.settings).get("Prior") == "machine family")
    if data.run.verification is not None:
        sentences.append(t["method_verified"])
    return sentences


def standards(data: ReportData, t: Texts) -> list[str]:
    """Return the standards that were applied, each with what it was applied to, and the procedures of the settings."""
    identified, limited = data.identification is not None, bool(data.tolerances)
    applied = {
        "standard_names": identified,
        "standard_compensation": identified,
        "standard_probe": data.run.probe is not None,
        "standard_temperature": True,
        "standard_uncertainty": True,
        "standard_decision": identified and limited,
    }
    names = [name for name, is_applied in applied.items() if is_applied]
    return [*(t[name] for name in names), *(as_it_is(text) for text in data.document.procedures)]


def signatures(document: ReportSettings, t: Texts) -> Sequence[tuple[str, str]]:
    """Return the role and the name of each person who signs; the name is empty if it is not stated."""
    people = (("measured_by", document.measured_by), ("approved_by", document.approved_by))
    return [(t[role], "" if name is None else as_it_is(name)) for role, name in people]
