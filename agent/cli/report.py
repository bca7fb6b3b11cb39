"""Command `volcal report`, which writes the report of a run.

The report is written from the journal, the database in which all runs are recorded, even if a report of the run already
exists.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option
from agent.cli.step_lists import steps_option
from agent.language.sentences import LANGUAGES, Language

if will_run():
    from agent.cli.step_lists import write_run_steps
    from agent.execution.run_record import run_ids
    from agent.files import write_all_atomically
    from agent.reports.render_from_journal import render_from_journal
    from agent.settings.load import naming, read_settings
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
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def report_command(
    run: str, config: Path, pdf: bool, out: Path | None, language: Language | None, steps: Path | None, as_json: bool
) -> None:
    """Write the report of RUN (its identity, or `last`) from the journal alone, whatever the outcome of the run."""
    with naming(config):
        settings = read_settings(config)
    directory = settings.state_directory
    run_id = _identity(run, directory)
    if steps is not None:
        write_run_steps(directory, run_id, steps)
        return
    folder = out or directory / run_id
    files = render_from_journal(directory, run_id, pdf=pdf, language=language or settings.report.language)
    write_all_atomically(folder, files)
    written = [str(folder / name) for name in files]
    click.echo(json.dumps({"run_id": run_id, "files": written}) if as_json else "\n".join(written))


def _identity(run: str, directory: Path) -> str:
    if run != LAST:
        return run
    known = run_ids(directory)
    if not known:
        raise InputError("the journal contains no run yet", directory=str(directory))
    return known[-1]
