"""Administrative data of a certificate: who certifies what for whom, with which instruments."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from typing import Final

from lxml import etree

from agent.language.sentences import Language
from agent.reports.digital_certificate.elements import (
    LANGUAGES,
    add,
    add_identifications,
    add_said,
    add_software,
    add_translated,
    add_words,
)
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.document_head import calibration_notes, listed_instruments, report_number
from agent.reports.page.identity import validity
from agent.reports.page.texts import Texts
from agent.results.gates.gate_rules import GATE_RULES
from agent.settings.report import Laboratory, MachineIdentity, ReportSettings
from drivers.errors import ConfigurationError

NAMESPACE: Final = "volcal"
"""Prefix of the `refType`s that the program defines."""
MEANINGS: Final = {
    "volumetricError": "volumetric error of the machine without compensation",
    "volumetricCompensatedError": "volumetric error that remains with the compensation table",
    "heldOutResidual": "rms residual of balls that the estimate does not use",
    "errorMotionRange": "range of an error motion over the travel of the axis",
    "squareness": "squareness of two axes",
    "acceptanceFigure": "predicted figure of an acceptance test",
    "tolerance": "tolerance of a quantity",
}
"""Meaning of each `refType` that the program defines, without its prefix."""


def completed(document: ReportSettings, now: ReportSettings) -> ReportSettings:
    """Return the document data of a run with customer and machine, if it does not state them, taken from the settings
    `now`. The laboratory that issues the certificate is always that of `now`.

    Number, place and persons are those of the run alone: the present ones may be others.
    """
    head = {"customer": now.customer} if document.customer is None else {}
    stated = document.machine.model_dump(exclude_none=True)
    machine = MachineIdentity(**(now.machine.model_dump(exclude_none=True) | stated))
    return document.model_copy(update={**head, "machine": machine, "laboratory": now.laboratory})


def check_complete(document: ReportSettings) -> None:
    """Raise ConfigurationError, which names the keys, if the settings do not state what a certificate must state."""
    missing = list(_missing(document))
    if missing:
        raise ConfigurationError(
            f"a digital certificate needs what the settings do not state: {', '.join(missing)}",
            hint="state it in the section [report]. Persons must be stated there before the run begins",
            key=missing[0],
        )


def _missing(document: ReportSettings) -> Iterator[str]:
    laboratory = document.laboratory
    for name in ("name", "city", "country"):
        if getattr(laboratory, name) is None:
            yield f"report.laboratory.{name}"
    if document.customer is None:
        yield "report.customer"
    if document.machine.serial_number is None:
        yield "report.machine.serial_number"
    if document.measured_by is None and document.approved_by is None:
        yield "report.measured_by"


def was_measured(found: IdentificationData) -> bool:
    """Return True unless the temperature of the artefact is one that nobody measured."""
    return found.thermometer is None or found.thermometer.was_read


def add_administration(
    root: etree._Element,
    data: ReportData,
    found: IdentificationData,
    language: Language,
    issued: datetime.date,
    t: Texts,
) -> None:
    """Add the administrative data of a report whose settings are complete."""
    stated = data.document
    head = add(root, "administrativeData")
    add_software(add(head, "dccSoftware"), data.header.software_version)
    _add_definitions(head)
    _add_core(head, data, language, issued)
    _add_item(head, data)
    _add_laboratory(head, stated.laboratory)
    _add_persons(head, stated)
    customer = add(head, "customer")
    add_said(customer, "name", stated.customer or "")
    place = add(customer, "location")
    if stated.place is None:
        add_words(place, "further", t["not_stated"])
    else:
        add_said(place, "further", stated.place)
    _add_statements(head, data, found, t)


def _add_definitions(head: etree._Element) -> None:
    definitions = add(head, "refTypeDefinitions")
    for name, meaning in MEANINGS.items():
        one = add(definitions, "refTypeDefinition")
        add_words(one, "name", meaning)
        add(one, "namespace", NAMESPACE)
        add(one, "link", "urn:volcal:ref-types")
        add(one, "value", name)


def _add_core(head: etree._Element, data: ReportData, language: Language, issued: datetime.date) -> None:
    ended = data.header.timestamp[:10]
    began = next((text[:10] for name, text in data.run.times if name == "Started"), ended)
    core = add(head, "coreData")
    add(core, "countryCodeISO3166_1", data.document.laboratory.country)
    for one in LANGUAGES:
        add(core, "usedLangCodeISO639_1", one)
    add(core, "mandatoryLangCodeISO639_1", language)
    add(core, "uniqueIdentifier", report_number(data))
    add_identifications(core, [("calibrationLaboratory", data.header.run_id, "identity of the run")])
    add(core, "beginPerformanceDate", began)
    add(core, "endPerformanceDate", ended)
    add(core, "performanceLocation", data.document.laboratory.performed_at)
    add(core, "issueDate", issued.isoformat())


def _add_item(head: etree._Element, data: ReportData) -> None:
    machine = data.document.machine
    item = add(add(head, "items"), "item")
    add_said(item, "name", data.machine)
    if machine.maker is not None:
        add_said(add(item, "manufacturer"), "name", machine.maker)
    if machine.model is not None:
        add(item, "model", machine.model)
    add_identifications(item, [("manufacturer", machine.serial_number or "", "serial number")])


def _add_laboratory(head: etree._Element, laboratory: Laboratory) -> None:
    issuer = add(head, "calibrationLaboratory")
    if laboratory.code is not None:
        add(issuer, "calibrationLaboratoryCode", laboratory.code)
    contact = add(issuer, "contact")
    add_said(contact, "name", laboratory.name or "")
    if laboratory.e_mail is not None:
        add(contact, "eMail", laboratory.e_mail)
    location = add(contact, "location")
    places = {"city": laboratory.city, "countryCode": laboratory.country, "postCode": laboratory.post_code}
    for name, text in {**places, "street": laboratory.street}.items():
        if text is not None:
            add(location, name, text)


def _add_persons(head: etree._Element, stated: ReportSettings) -> None:
    people = add(head, "respPersons")
    named = [("Approved by", stated.approved_by), ("Measured by", stated.measured_by)]
    for number, (role, name) in enumerate((role, name) for role, name in named if name is not None):
        one = add(people, "respPerson")
        add_said(add(one, "person"), "name", name)
        add_words(one, "description", role)
        add(one, "mainSigner", "true" if number == 0 else "false")


def _add_statements(head: etree._Element, data: ReportData, found: IdentificationData, t: Texts) -> None:
    """Add what must be known of the results: verdict, coverage, decision rule, accreditation, validity and notes."""
    statements = add(head, "statements")
    _add_verdict(statements, data, t)
    coverage = add(statements, "statement")
    add_words(coverage, "name", "Uncertainty")
    add(coverage, "norm", "JCGM 100:2008")
    add_words(coverage, "declaration", t["convention"])
    if data.tolerances:
        rule = add(statements, "statement")
        add_words(rule, "name", "Decision rule")
        add(rule, "norm", "ISO 14253-1")
        add_words(rule, "declaration", t["decision_rule"])
    if data.document.laboratory.code is None:
        issuer = add(statements, "statement")
        add_words(issuer, "name", "Accreditation")
        add_words(
            issuer,
            "declaration",
            "The issuer does not state an accreditation. This document is not a calibration certificate of an "
            "accredited laboratory.",
        )
    notes = [*calibration_notes(data, t), *data.warnings]
    if found.thermometer is not None and not was_measured(found):
        unread = found.thermometer.warning
        notes += [unread] if unread is not None and unread not in notes else []
    for title, sentences in ((t["validity"], validity(data, found)), (t["note"], notes)):
        if sentences:
            one = add(statements, "statement")
            add_words(one, "name", title)
            add_words(one, "declaration", *sentences)


def _add_verdict(statements: etree._Element, data: ReportData, t: Texts) -> None:
    """Add how the run ended, and each limit that it did not meet."""
    verdict = data.header.verdict
    if verdict is not None:
        one = add(statements, "statement")
        add_translated(one, "name", verdict.word)
        add_translated(one, "declaration", verdict.sentence)
    remarks = []
    if data.withholds_conformity:
        remarks.append(t["no_conformity"])
    remarks += [
        f"The limit of the {GATE_RULES[gate.name].title} was not met: {gate.text}"
        for gate in data.gates
        if not gate.passed
    ]
    if remarks:
        one = add(statements, "statement")
        add_words(one, "name", "Limitations of the results")
        add_words(one, "declaration", *remarks)


def add_equipment(results: etree._Element, data: ReportData, t: Texts) -> None:
    """Add the instruments with their numbers, and with the certificate and date of their calibration."""
    listed = add(results, "measuringEquipments")
    for one in listed_instruments(data):
        equipment = add(listed, "measuringEquipment")
        if one.name is None:
            add_words(equipment, "name", t[f"instrument_{one.kind}"])
        else:
            add_said(equipment, "name", one.name)
        said = [t[f"instrument_{one.kind}"]]
        said += [f"calibrated on {one.calibrated.isoformat()}"] if one.calibrated is not None else []
        said += [f"next calibration due on {one.due.isoformat()}"] if one.due is not None else []
        add_words(equipment, "description", *said)
        add_identifications(
            equipment,
            [
                ("manufacturer", one.serial_number or "", "serial number"),
                ("calibrationLaboratory", one.certificate or "", "certificate of calibration"),
            ],
        )
