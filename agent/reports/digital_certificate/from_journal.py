"""Digital calibration certificate of a run, from the journal."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np

from agent.certificates.xml_signature import Signer
from agent.execution.journal_reader import open_journal
from agent.execution.run_record import read_record
from agent.language.sentences import Language
from agent.reports.digital_certificate.administration import completed
from agent.reports.digital_certificate.certificate_of_report import certificate_of_report
from agent.reports.page.pdf import render_pdf
from agent.reports.page.render import render_report
from agent.reports.run_report import report_of
from agent.results.table_image import table_of
from agent.settings.report import ReportSettings


def certificate_from_journal(
    directory: Path,
    run_id: str,
    settings: ReportSettings,
    issued: datetime.date,
    *,
    language: Language,
    with_pdf: bool = False,
    signer: Signer | None = None,
) -> bytes:
    """Return the certificate of the run `run_id` as XML text, from the journal in `directory`.

    `settings` are the present ones (`certificate_of_report`). If `with_pdf` is set, the certificate holds the report as
    PDF. Raises InputError if there is no such run, or if it has no estimate, and ConfigurationError if the settings do
    not state what a certificate must state.
    """
    record = read_record(directory, run_id)
    data = report_of(record)
    # the PDF must state what the certificate states that holds it
    data = replace(data, document=completed(data.document, settings))
    pdf = render_pdf(render_report(data, language=language)) if with_pdf else None
    with open_journal(directory) as reader:
        staged = record.table("staged")
        image = None if staged is None else reader.image(staged)
    table = None if image is None else table_of(image, np.asarray(data.tool_offset))
    return certificate_of_report(data, settings, issued, table=table, language=language, pdf=pdf, signer=signer)
