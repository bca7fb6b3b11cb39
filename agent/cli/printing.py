"""Output of tables and lines on standard output. Identities and paths are never truncated."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from rich.console import JustifyMethod

UNLIMITED = 100_000
"""Width in characters of output to a pipe or file. It is so large that every line is written whole."""


def results_console() -> Console:
    """Return the console on standard output.

    In a terminal its width is that of the terminal; elsewhere the width is not limited. A line outside a table is never
    wrapped.
    """
    width = None if sys.stdout.isatty() else UNLIMITED
    return Console(width=width, highlight=False, soft_wrap=True)


def columns_table(
    headings: Sequence[str], *, title: str | None = None, whole: Sequence[str] = (), numbers: Sequence[str] = ()
) -> Table:
    """Return an empty table with one column per heading.

    Columns named in `whole` are never narrowed; the text of other columns is folded over several lines if the terminal
    is too narrow. Columns named in `numbers` are aligned to the right.
    """
    table = Table(title=title, title_justify="left")
    for heading in headings:
        justify: JustifyMethod = "right" if heading in numbers else "left"
        table.add_column(heading, overflow="fold", no_wrap=heading in whole, justify=justify)
    return table


def facts_table(rows: Iterable[tuple[str, str]], *, title: str | None = None) -> Table:
    """Return a table of names and values without a header; long values are folded."""
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(overflow="fold")
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value)
    return table
