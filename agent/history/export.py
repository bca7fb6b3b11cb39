"""Export of the history of runs as CSV or JSON, without columns that serve only the history database."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from agent.history.schema import RUNS, StoredRun, utc_text
from agent.history.stored_rows import damage_of_history
from agent.printable import no_formula

COLUMNS = tuple(column.key for column in RUNS.columns if column.key != "digest")


def run_document(run: StoredRun, *, whole: bool = True) -> dict[str, Any]:
    """Return one run as a mapping that can be written as JSON. The keys are described in docs/reference/json.md.

    If `whole` is True, the mapping includes the estimated parameters, the temperatures and the decisions of the run.
    """
    document = {**{name: _plain(getattr(run, name)) for name in COLUMNS}, "verdict": run.verdict.as_json()}
    if whole:
        document["parameters"] = [
            {"name": p.name, "value": p.value, "standard_uncertainty": p.standard_uncertainty, "unit": p.unit}
            for p in run.parameters
        ]
        document["temperatures_c"] = {t.sensor: [t.lowest, t.mean, t.highest] for t in run.temperatures}
        document["decisions"] = [
            {"at": _plain(d.at), "kind": d.kind, "record": _record(d.record)} for d in run.decisions
        ]
    return document


def as_csv(runs: Sequence[StoredRun]) -> str:
    """Return CSV text with one line per run.

    The last columns hold the value and the standard uncertainty of each parameter of the error model. A text that a
    spreadsheet would take for a formula has an apostrophe in front.
    """
    names = list(dict.fromkeys(p.name for run in runs for p in run.parameters))
    units = {p.name: p.unit for run in runs for p in run.parameters}
    heads = [head for name in names for head in (f"{name}_{units[name]}", f"u_{name}_{units[name]}")]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([*COLUMNS, "verdict", *heads])
    for run in runs:
        known = {p.name: (p.value, p.standard_uncertainty) for p in run.parameters}
        values = [value for name in names for value in known.get(name, (None, None))]
        writer.writerow([*(_cell(getattr(run, name)) for name in COLUMNS), run.verdict.name, *values])
    return file.getvalue()


def as_json(runs: Sequence[StoredRun]) -> str:
    return json.dumps({"runs": [run_document(run) for run in runs]}, allow_nan=False, indent=1) + "\n"


def _cell(value: object) -> object:
    return no_formula(value) if isinstance(value, str) else _plain(value)


def _record(text: str) -> object:
    with damage_of_history():
        record: object = json.loads(text, parse_float=_finite, parse_constant=_finite)
        return record


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:20]} is not a finite number")
    return value


def _plain(value: object) -> object:
    if isinstance(value, datetime):
        return utc_text(value)
    return value
