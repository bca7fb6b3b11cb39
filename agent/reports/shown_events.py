"""Selection of the events that a report shows, and their wording.

At the end of every position, the first ball is measured again, and its displacement is recorded. The report summarises
all these displacements in one line, and lists a single displacement only if it exceeds a limit. The report lists every
event that required a decision.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from agent.execution.journal_rows import EventRow
from agent.execution.run_record import RunRecord
from agent.reports.page import EventLine


def shown_events(record: RunRecord) -> tuple[EventLine, ...]:
    kept = [note for note in record.events if not _routine(note)]
    drifts = [note for note in record.events if _drift_um(note) is not None]
    lines = [EventLine(note.at, note.kind, _line(note)) for note in kept]
    if drifts:
        largest = max(_drift_um(note) or 0.0 for note in drifts)
        text = f"first ball measured again in {len(drifts)} positions, largest displacement {largest:.1f} µm"
        lines.append(EventLine(drifts[-1].at, "event", text))
    return tuple(sorted(lines, key=lambda line: line.timestamp))


def drifts_um(record: RunRecord) -> tuple[float, ...]:
    """Return the drift of each position in µm, in the order of measurement. The drift is the displacement of the
    position's first ball when it is measured again at the end of the position."""
    found = (_drift_um(note) for note in record.events)
    return tuple(one for one in found if one is not None)


def _routine(note: EventRow) -> bool:
    record = note.record
    drift_um = _drift_um(note)
    if drift_um is not None:
        return "note" not in record and bool(drift_um <= record["limit_um"])
    return note.kind == "asked" or str(record.get("step", "")).endswith("/found")


def _drift_um(note: EventRow) -> float | None:
    values = note.record.get("drift_um")
    return None if values is None or "limit_um" not in note.record else float(np.linalg.norm(values))


def _line(note: EventRow) -> str:
    """Return the text of an event: the name of the new state and the reason, or the record in words."""
    if note.kind == "state":
        reason = note.record.get("reason")
        return f"{note.record['state']}: {reason}" if reason else str(note.record["state"])
    if note.kind == "note":
        others = record_in_words({name: value for name, value in note.record.items() if name != "text"})
        return f"{note.record['text']} ({others})" if others else str(note.record["text"])
    return record_in_words(note.record)


def record_in_words(record: Mapping[str, Any]) -> str:
    """Return a journal record as a text of the form `name value, name value`. Floats have four significant digits, and
    empty values are left out."""
    return ", ".join(f"{name} {_shown(value)}" for name, value in record.items() if value not in ("", None))


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return "[" + ", ".join(_shown(part) for part in value) + "]"
    return str(value)
