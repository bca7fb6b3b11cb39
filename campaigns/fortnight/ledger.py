"""Check of the run journal and the run history after the fortnight, row by row, against the records of the evenings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import open_journal
from agent.runs.reference_state import read_reference
from campaigns.fortnight.evening import Evening, ExpectedRun
from campaigns.fortnight.plant import FortnightPlant
from campaigns.fortnight.service_process import STATUS_POLL_S, ServiceHost, wait_for

Row = dict[str, Any]


def read_history(host: ServiceHost) -> list[Row]:
    """Return the rows (one for each run) that the command `volcal history list` prints, with the oldest run first."""
    rows: list[Row] = json.loads(host.output("history", "list", "--last", "100", "--json"))["runs"]
    return rows


def read_trends(host: ServiceHost, figure: Path | None = None) -> Row:
    """Return the trends of three machine errors over the runs, as the command `volcal history trend` reports them.

    They are the volumetric error without a compensation table, the volumetric error with the active table, and the
    error at positions that are held out from the estimate.
    """
    names = [part for name in ("ve_bare", "ve_acting", "held_out") for part in ("--of", name)]
    drawn = [] if figure is None else ["--figure", str(figure)]
    document: Row = json.loads(host.output("history", "trend", *names, *drawn, "--json"))
    return document


def mismatched_rows(host: ServiceHost, evenings: Sequence[Evening], rows: Sequence[Row]) -> list[str]:
    """Return a description of each row of the run history that differs from the row expected for that run in
    `evenings`.

    A further description is returned if the journal does not contain the same runs as the history, in the same order
    and with the same final states.
    """
    expected = [(evening, row) for evening in evenings for row in evening.expected]
    found = [*_against(expected, rows)]
    with open_journal(host.state) as reader:
        journal = [(run.run_id, run.kind, run.state, run.reason or "") for run in reader.runs()]
    told = [(row["run_id"], row["kind"], row["state"], row["reason"]) for row in rows]
    if journal != told:
        found.append(f"journal and history differ: {sorted(set(journal) ^ set(told))}")
    return found


def _against(expected: Sequence[tuple[Evening, ExpectedRun]], rows: Sequence[Row]) -> list[str]:
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


def active_table_is_accepted(host: ServiceHost, plant: FortnightPlant) -> bool:
    """Return True if the controller's active bank holds the compensation table that was accepted last. Wait until the
    service reports this bank as active: after a run that ended with an error, it has to read it first.
    """
    last = read_reference(host.state)
    wait_for(lambda: host.status()["active_bank"] == plant.active_bank, "the active bank", STATUS_POLL_S)
    return last is not None and last.table.crc32 == plant.active_crc32


def leftover_processes(directory: Path) -> list[str]:
    """Return the command lines of all running processes that contain the path `directory`, in which the fortnight
    ran.
    """
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = place.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # the process has just ended
        if str(directory) in command:
            found.append(command.strip())
    return found
