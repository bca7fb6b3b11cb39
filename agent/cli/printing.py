"""Printing of tables and lines on standard output. Run identities and file paths are never truncated."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console, Group
from rich.constrain import Constrain
from rich.table import Table
from rich.text import Text

from agent.figures.heading import subject
from agent.results.travel_parts import TravelParts

if TYPE_CHECKING:
    from rich.console import JustifyMethod, RenderableType

    from agent.results.gates.gate_forecast import GateForecast
    from twin.compensation.table import CompensationTable

PAGE_WIDTH = 96
"""Largest width in characters of a table of figures, also in a wider terminal and in a pipe."""
UNLIMITED = 100_000
"""Width in characters of output to a pipe or file. It is so large that every line is written whole."""


def results_console() -> Console:
    """Return a console that prints on standard output.

    In a terminal, the console is as wide as the terminal. Otherwise, its width is not limited. A line outside a table
    is never wrapped. No text is read as markup, not even in a table, because names come from other programs and
    people. Give a style with a `Text`.
    """
    width = None if sys.stdout.isatty() else UNLIMITED
    return Console(width=width, highlight=False, soft_wrap=True, markup=False, emoji=False)


def columns_table(
    headings: Sequence[str], *, title: str | None = None, whole: Sequence[str] = (), numbers: Sequence[str] = ()
) -> Table:
    """Return an empty table with one column per heading.

    A column named in `whole` is never narrowed. The text of every other column is folded over several lines if the
    terminal is too narrow. The text of a column named in `numbers` is right-aligned.
    """
    table = Table(title=title, title_justify="left")
    for heading in headings:
        justify: JustifyMethod = "right" if heading in numbers else "left"
        table.add_column(heading, overflow="fold", no_wrap=heading in whole, justify=justify)
    return table


def facts_table(rows: Iterable[tuple[str, str]], *, title: str | None = None) -> Table:
    """Return a table with the two columns name and value and without a header. Long values are folded over several
    lines.
    """
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(overflow="fold")
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(name), Text(value))  # never read as markup: values may come from other programs
    return table


def gates_table(forecasts: Sequence[GateForecast]) -> RenderableType:
    """Return a table with the expected value and the limit of each gate of a run, followed by what to do about each
    gate that is expected to refuse the run. It is at most `PAGE_WIDTH` wide."""
    table = columns_table(("gate", "expected", "limit", "", "settings key"), title="forecast of the gates")
    for forecast in forecasts:
        mark = Text("pass", "green") if forecast.passes else Text("refuse", "red")
        table.add_row(forecast.gate, forecast.expected_text, forecast.limit_text, mark, forecast.key)
    remedies = facts_table((one.gate, one.remedy) for one in forecasts if one.remedy)
    return Constrain(Group(table, remedies) if remedies.row_count else table, PAGE_WIDTH)


def table_subject(table: CompensationTable) -> str:
    """Return the line that names the machine of a compensation table and its artefact, if they are known."""
    return subject(table.machine or "not stated", table.artefact or "not stated")


def travel_rows(travel: TravelParts) -> list[tuple[str, str]]:
    """Return rows (name, text) with the volumetric error before and after compensation inside and outside the measured
    region."""
    rows = []
    for name, part in (("VE → VCE where measured", travel.measured), ("VE → VCE elsewhere", travel.unmeasured)):
        if part is not None:
            lower, upper = part.predicted_vce_limits_um
            text = f"{part.estimated_ve_um:.2f} → {part.predicted_vce_um:.2f} µm (95 %: {lower:.2f} to {upper:.2f})"
            rows.append((name, f"{text}, {100.0 * part.share:.0f} % of the travel"))
    return rows


def readings_text(readings_c: Mapping[str, float]) -> str:
    """Return readings in °C by sensor as text."""
    return ", ".join(f"{sensor} {value:.2f} °C" for sensor, value in readings_c.items())
