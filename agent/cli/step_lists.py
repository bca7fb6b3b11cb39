"""Lists of the steps of a run: those that the preflight walked, by branch, and those that a run carried out."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from agent.cli.invocation import will_run

if will_run():
    from agent.execution.journal_reader import open_journal
    from agent.files import write_all_atomically
    from agent.planning.branch_walk import Branch
    from twin.units import S_PER_MIN

BRANCH_COLUMNS = ("branch", "key", "minutes")
RUN_COLUMNS = ("key", "minutes")

steps_option = click.option(
    "--steps",
    type=click.Path(path_type=Path, dir_okay=False, allow_dash=True),
    metavar="FILE",
    help="Write the steps, with the machine time at which each ends, into the CSV file FILE; - is stdout.",
)


def write_branch_steps(branches: Sequence[Branch], file: Path) -> None:
    """Write the keys of the steps of each branch, with the machine minutes at which each step ends. Raises InputError
    if `file` cannot be written."""
    rows = (
        (branch.name, key, f"{branch.timeline[key] / S_PER_MIN:.4f}" if key in branch.timeline else "")
        for branch in branches
        for key in branch.keys
    )
    write_rows(BRANCH_COLUMNS, rows, file)


def write_run_steps(directory: Path, run_id: str, file: Path) -> None:
    """Write the keys of the steps that the run `run_id` carried out as its procedure, in order, with the machine
    minutes since its first step at which each of them ended. The journal is in the state directory `directory`.

    Raises InputError if there is no such run or if `file` cannot be written.
    """
    with open_journal(directory) as reader:
        steps = reader.steps(reader.require_run(run_id).run, procedure_only=True)
    first_s = steps[0].begun_s if steps else 0.0
    ends = ((step.key, step.finished_s) for step in steps)
    rows = ((key, "" if end_s is None else f"{(end_s - first_s) / S_PER_MIN:.4f}") for key, end_s in ends)
    write_rows(RUN_COLUMNS, rows, file)


def write_rows(columns: Sequence[str], rows: Iterable[Sequence[str]], file: Path) -> None:
    """Write `rows` below a row with the names `columns` as CSV, into `file` or, if it is ``-``, to stdout."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    if str(file) == "-":
        click.echo(text.getvalue(), nl=False)
        return
    write_all_atomically(file.parent, {file.name: text.getvalue()})
