"""What stands in journal and history at the end, row by row, against what the evenings were."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import open_journal
from agent.runs.reference_state import last_accepted
from campaigns.fortnight.evening import Evening, Expected
from campaigns.fortnight.house import House
from campaigns.fortnight.plant import Plant

Row = dict[str, Any]


def history_of(house: House) -> list[Row]:
    """The rows of history as `volcal history list` tells them, the oldest first."""
    rows: list[Row] = json.loads(house.asked("history", "list", "--last", "100", "--json"))["runs"]
    return rows


def trends_of(house: House, figure: Path | None = None) -> Row:
    """`volcal history trend` of the three volumetric errors."""
    names = [part for name in ("ve_bare", "ve_acting", "held_out") for part in ("--of", name)]
    drawn = [] if figure is None else ["--figure", str(figure)]
    document: Row = json.loads(house.asked("history", "trend", *names, *drawn, "--json"))
    return document


def differing(house: House, evenings: Sequence[Evening], rows: Sequence[Row]) -> list[str]:
    """Rows that are not what they should be; the journal has the same runs in the same order, with the same ends."""
    expected = [(evening, row) for evening in evenings for row in evening.expected]
    found = [*_against(expected, rows)]
    with open_journal(house.state) as reader:
        journal = [(run.run_id, run.kind, run.state, run.reason or "") for run in reader.runs()]
    told = [(row["run_id"], row["kind"], row["state"], row["reason"]) for row in rows]
    if journal != told:
        found.append(f"journal and history differ: {sorted(set(journal) ^ set(told))}")
    return found


def _against(expected: Sequence[tuple[Evening, Expected]], rows: Sequence[Row]) -> list[str]:
    if len(expected) != len(rows):
        return [f"{len(rows)} runs in history instead of {len(expected)}"]
    wrong = []
    for (evening, want), row in zip(expected, rows, strict=True):
        fits = (
            (row["kind"], row["state"], row["started_by"]) == (want.kind, want.state, want.by)
            and row["night"] in want.decision
            and want.reason in row["reason"]
            and want.accepted in (None, row["accepted"])
        )
        if not fits:
            names = ("kind", "state", "started_by", "night", "reason", "accepted")
            wrong.append(f"night {evening.night + 1}: { {name: row[name] for name in names} } instead of {want}")
    return wrong


def acting_is_accepted(house: House, plant: Plant) -> bool:
    """The bank that acts holds the table of the last accepted night, and the service says so."""
    last = last_accepted(house.state)
    accepted = last is not None and last.accepted.crc32 == plant.active_crc32
    return accepted and house.status()["active_bank"] == plant.active_bank


def left_over(directory: Path) -> list[str]:
    """Processes that still have to do with the fortnight."""
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = place.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # it has just ended
        if str(directory) in command:
            found.append(command.strip())
    return found
