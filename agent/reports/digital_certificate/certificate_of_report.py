"""Digital calibration certificate of a report."""

from __future__ import annotations

import base64
import datetime
from dataclasses import replace

from lxml import etree

from agent.certificates.xml_signature import Signer
from agent.language.sentences import Language
from agent.reports.digital_certificate.administration import add_administration, check_complete, completed
from agent.reports.digital_certificate.elements import add, new_root
from agent.reports.digital_certificate.results import add_results
from agent.reports.page.data import ReportData
from agent.reports.page.texts import ENGLISH
from agent.settings.report import ReportSettings
from drivers.errors import InputError
from twin.compensation.table import CompensationTable


def certificate_of_report(
    data: ReportData,
    settings: ReportSettings,
    issued: datetime.date,
    *,
    table: CompensationTable | None = None,
    language: Language = "en",
    pdf: bytes | None = None,
    signer: Signer | None = None,
) -> bytes:
    """Return the certificate of a calibration as XML text (UTF-8).

    All texts are in English and German; `language` is the one that counts. Customer and machine are taken from
    `settings` if the document data of the run do not state them, and the laboratory always is. `pdf` is the report for
    people, which becomes a part of it. Without a `signer` it is not signed.

    Raises InputError if the run has no estimate or ended after `issued`, and ConfigurationError if the settings do not
    state what a certificate must state.
    """
    found = data.identification
    if found is None:
        raise InputError(
            "the run has no result that can be certified",
            run=data.header.run_id,
            hint="name a calibration that has identified the errors of the machine",
        )
    ended = datetime.date.fromisoformat(data.header.timestamp[:10])
    if issued < ended:
        raise InputError(
            f"the certificate would be issued on {issued}, before the end of the run on {ended}",
            run=data.header.run_id,
            hint="check the clock of this computer",
        )
    document = completed(data.document, settings)
    check_complete(document)
    whole = replace(data, document=document)
    root = new_root()
    add_administration(root, whole, found, language, issued, ENGLISH)
    add_results(root, whole, found, table, ENGLISH)
    if pdf is not None:
        held = add(root, "document")
        add(held, "fileName", "report.pdf")
        add(held, "mimeType", "application/pdf")
        encoded = etree.SubElement(held, held.tag.replace("document", "dataBase64"))
        encoded.text = base64.b64encode(pdf).decode("ascii")
    etree.indent(root)
    signed = root if signer is None else signer.signed(root)
    return etree.tostring(signed, xml_declaration=True, encoding="UTF-8")
