"""Command `volcal report`, which writes the report of a run.

The report is written from the journal, the database in which all runs are recorded, even if a report of the run already
exists.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, config_option
from agent.cli.step_lists import steps_option
from agent.language.sentences import LANGUAGES, Language

if will_run():
    import datetime

    from agent.cli.step_lists import write_run_steps
    from agent.execution.run_record import run_ids
    from agent.files import write_all_atomically
    from agent.reports.render_from_journal import render_from_journal
    from agent.settings.load import naming, read_settings
    from agent.settings.report import ReportSettings, SignatureSettings
    from drivers.clock import utc_timestamp
    from drivers.errors import InputError

LAST = "last"


@click.command("report")
@click.argument("run", metavar="RUN")
@config_option
@click.option("--pdf", is_flag=True, help="Write report.pdf beside report.html.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder to write to [default: the folder of the run]."
)
@click.option("--language", type=click.Choice(LANGUAGES), help="Language of the report [default: `report.language`].")
@steps_option
@click.option(
    "--dcc",
    type=PATH,
    metavar="FILE.xml",
    help="Write the result as a digital calibration certificate instead; with --pdf, it holds the PDF.",
)
@click.option("--signing-key", type=PATH, metavar="KEY.pem", help="Key of its signature [default: `report.signature`].")
@click.option(
    "--signing-certificate",
    type=PATH,
    metavar="CERT.pem",
    help="Certificate of that key [default: `report.signature`].",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def report_command(
    run: str,
    config: Path,
    pdf: bool,
    out: Path | None,
    language: Language | None,
    steps: Path | None,
    dcc: Path | None,
    signing_key: Path | None,
    signing_certificate: Path | None,
    as_json: bool,
) -> None:
    """Write the report of RUN (its identity, or `last`) from the journal alone, whatever the outcome of the run."""
    if dcc is None and (signing_key, signing_certificate) != (None, None):
        raise click.UsageError("--signing-key and --signing-certificate belong to --dcc")
    if dcc is not None and (out is not None or steps is not None):
        raise click.UsageError("--dcc excludes --out and --steps: it names the one file that is written")
    with naming(config):
        settings = read_settings(config)
    directory = settings.state_directory
    run_id = _identity(run, directory)
    if steps is not None:
        write_run_steps(directory, run_id, steps)
        return
    chosen = language or settings.report.language
    if dcc is not None:
        with naming(config):
            printed = _write_certificate(
                dcc, directory, run_id, settings.report, chosen, pdf, (signing_key, signing_certificate)
            )
        click.echo(json.dumps(printed) if as_json else printed["files"][0])
        return
    folder = out or directory / run_id
    files = render_from_journal(directory, run_id, pdf=pdf, language=chosen)
    write_all_atomically(folder, files)
    written = [str(folder / name) for name in files]
    click.echo(json.dumps({"run_id": run_id, "files": written}) if as_json else "\n".join(written))


def _write_certificate(
    file: Path,
    directory: Path,
    run_id: str,
    settings: ReportSettings,
    language: Language,
    with_pdf: bool,
    files: tuple[Path | None, Path | None],
) -> dict[str, Any]:
    """Write the digital certificate of a run and return what is printed of it. `files` are the key and the certificate
    of its signature, each of which is None for that of the settings. A warning says if it is not signed."""
    # only this option needs XML and its signatures
    from agent.certificates.xml_signature import signer_of  # noqa: PLC0415
    from agent.reports.digital_certificate.from_journal import certificate_from_journal  # noqa: PLC0415

    now = datetime.datetime.fromisoformat(utc_timestamp())
    key, certificate = files
    signature = SignatureSettings(
        key_file=key or settings.signature.key_file, certificate_file=certificate or settings.signature.certificate_file
    )
    signer = signer_of(signature.key_file, signature.certificate_file, now, key_is_stated=key is not None)
    content = certificate_from_journal(
        directory, run_id, settings, now.date(), language=language, with_pdf=with_pdf, signer=signer
    )
    write_all_atomically(file.parent, {file.name: content})
    if signer is None:
        click.echo(
            "warning: the certificate is NOT SIGNED: anybody could change it. State `report.signature`, or pass "
            "--signing-key and --signing-certificate",
            err=True,
        )
    return {"run_id": run_id, "files": [str(file)], "signed": signer is not None}


def _identity(run: str, directory: Path) -> str:
    if run != LAST:
        return run
    known = run_ids(directory)
    if not known:
        raise InputError("the journal contains no run yet", directory=str(directory))
    return known[-1]
