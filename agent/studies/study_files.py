"""Files with the result of a study: NAME.png, NAME.svg, NAME.csv and NAME.json. NAME is the name of the study. The four
files are written together or not at all.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np

from agent.figures.style import picture
from agent.files import write_all_atomically
from agent.studies.study import Cell, StudyResult

DIGITS = 8
"""Significant digits in the CSV file, more than the accuracy of any value."""


def write_result(result: StudyResult, folder: Path) -> dict[str, Path]:
    """Write the result of a study to `folder` as four files (.png, .svg, .csv and .json), together or not at all.
    Return a mapping from file suffix to path. Raises InputError if the files cannot be written.
    """
    drawn = picture(result.name, result.draw, result.size_in)
    contents: dict[str, str | bytes] = {
        "png": drawn.png,
        "svg": drawn.svg,
        "csv": format_rows(result),
        "json": json.dumps(document(result), indent=2, allow_nan=False) + "\n",
    }
    write_all_atomically(folder, {f"{result.name}.{suffix}": content for suffix, content in contents.items()})
    return {suffix: folder / f"{result.name}.{suffix}" for suffix in contents}


def document(result: StudyResult) -> dict[str, object]:
    """Return the name, the title and the summary of a study result as a dictionary of JSON-compatible values."""
    plain = {key: as_plain(value) for key, value in result.summary.items()}
    return {"study": result.name, "title": result.title, **plain}


def format_rows(result: StudyResult) -> str:
    """Return the table of a study result as CSV text with one header line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(result.columns)
    for row in result.rows:
        if len(row) != len(result.columns):
            raise ValueError(f"a row of {result.name} has {len(row)} cells for {len(result.columns)} columns")
        writer.writerow([_cell(value) for value in row])
    return text.getvalue()


def as_plain(value: object) -> object:
    """Convert numpy numbers, arrays and nested containers to plain Python values."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {str(key): as_plain(held) for key, held in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(held) for held in value]
    return value


def _cell(value: Cell) -> str | int:
    plain = as_plain(value)
    if plain is None:
        return ""
    if isinstance(plain, bool):
        return "yes" if plain else "no"
    return f"{plain:.{DIGITS}g}" if isinstance(plain, float) else str(plain)
