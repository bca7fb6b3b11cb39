"""Lists of the steps of a run: those that the preflight walked, by branch, and those that a run carried out."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from agent.files import write_all_atomically
from agent.planning.branch_walk import Branch

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
        (branch.name, key, f"{branch.timeline[key] / 60.0:.4f}" if key in branch.timeline else "")
        for branch in branches
        for key in branch.keys
    )
    write_rows(BRANCH_COLUMNS, rows, file)


def write_rows(columns: Sequence[str], rows: Iterable[Sequence[str]], file: Path) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    if str(file) == "-":
        click.echo(text.getvalue(), nl=False)
        return
    write_all_atomically(file.parent, {file.name: text.getvalue()})
