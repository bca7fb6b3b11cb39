"""Tables that the command `volcal history compare` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from agent.cli.printing import columns_table

_FIGURES = {
    "VE, µm": ("ve_um", 2),
    "VCE, µm": ("vce_um", 2),
    "held out before, µm": ("held_out_before_um", 2),
    "held out after, µm": ("held_out_after_um", 2),
    "balls": ("balls", 0),
    "minutes": ("machine_minutes", 1),
}
"""Key of each compared figure in the document of a run, and its number of decimal places."""


def comparison_tables(document: Mapping[str, Any]) -> Iterator[Table | str]:
    """Yield the tables of a comparison, or the reason why there is none."""
    one, other = document["runs"]
    figures = columns_table(("", one["run_id"], other["run_id"], "change"), whole=(one["run_id"], other["run_id"]))
    for name in ("started", "kind"):
        figures.add_row(name, one[name], other[name], "")
    figures.add_row("verdict", *(f"{run['verdict']['sign']} {run['verdict']['word']}" for run in (one, other)), "")
    for name, (key, digits) in _FIGURES.items():
        values = [run[key] for run in (one, other)]
        shown = ("-" if value is None else f"{value:.{digits}f}" for value in values)
        figures.add_row(name, *shown, "-" if None in values else f"{values[1] - values[0]:+.{digits}f}")
    yield figures
    identified, tables = document["identified"], document["tables"]
    if "reason" in identified:
        yield identified["text"]
    else:
        yield from _changes_of_errors(identified)
    if "reason" in tables or tables["same"]:
        yield tables.get("text", "the tables are identical at all nodes")
        return
    changes = columns_table(("axis of the table", "largest change", "at X, Y, Z in mm", "rms"))
    for row in tables["axes"]:
        place = ", ".join(f"{value:.0f}" for value in row["at_mm"])
        changes.add_row(row["axis"], f"{row['largest_um']:+.2f} µm", place, f"{row['rms_um']:.2f} µm")
    yield changes


def _changes_of_errors(identified: Mapping[str, Any]) -> Iterator[Table | str]:
    errors = columns_table(("error", "largest change (95 %)", "at mm", ""))
    for row in identified["errors"]:
        place = "-" if row["at_mm"] is None else f"{row['at_mm']:.0f}"
        change = f"{row['largest']:+.2f} ± {row['expanded_uncertainty']:.2f} {row['unit']}"
        errors.add_row(row["name"], change, place, "changed" if row["significant"] else "")
    yield errors
    field = identified["field"]
    place = ", ".join(f"{value:.0f}" for value in field["at_mm"])
    yield (
        f"error field without table: rms change {field['rms_um']:.2f} µm, largest {field['largest_um']:.2f} µm at "
        f"X, Y, Z {place} mm"
    )
