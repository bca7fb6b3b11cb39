"""Update of the history database from the journal of one machine.

The update stores each run that is missing in the database and each run that has changed since the last update.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.run_record import read_record, run_heads, run_ids
from agent.history.run_row import machine_name, run_rows
from agent.history.schema import utc_time
from agent.history.store import HistoryStore, RunEnd


def sync(directory: Path, store: HistoryStore) -> tuple[str, ...]:
    """Copy all new and all changed runs from the journal in the state directory `directory` to the history
    database.

    Return the identities of the stored runs, in the order in which they were stored. Raises LinkLost if the connection
    to the database is lost; the next call of this function then stores the remaining runs.
    """
    return _store_changed(directory, run_ids(directory), store)


def sync_ends(directory: Path, store: HistoryStore) -> tuple[str, ...]:
    """Store in the history database the runs that have not ended, the runs whose end is not yet stored, and the runs to
    which something was added after their end. They are read from the journal in the state directory `directory`.

    Return the identities of the stored runs, in the order in which they were stored. Raises LinkLost if the connection
    to the database is lost.

    If the end of a run is already stored and nothing was added to it, only its journal row and its settings are read.
    This saves about 50 ms per run with an estimate of 1.5 MB. The function `sync` compares all runs completely.
    """
    stored: dict[str, dict[str, RunEnd]] = {}
    changed = []
    for head in run_heads(directory):
        machine = machine_name(head.settings)
        if machine not in stored:
            stored[machine] = dict(store.ends(machine))
        end = end_of(head.row)
        if end is None or head.added_after_end or stored[machine].get(head.row.run_id) != end:
            changed.append(head.row.run_id)
    return _store_changed(directory, changed, store)


def sync_missing(directory: Path, store: HistoryStore) -> frozenset[str]:
    """Store the runs whose start or end is missing in the history database, and return the identities of all runs of
    the journal in the state directory `directory`. Without a journal, nothing is stored.

    If nothing is missing, only the rows of the runs are read.
    """
    if not has_journal(directory):
        return frozenset()
    with open_journal(directory) as reader:
        rows = reader.runs()
    stored = store.ends(store.address.machine)
    if any(row.run_id not in stored or end_of(row) not in (None, stored[row.run_id]) for row in rows):
        sync_ends(directory, store)
    return frozenset(row.run_id for row in rows)


def _store_changed(directory: Path, chosen: Iterable[str], store: HistoryStore) -> tuple[str, ...]:
    stored: dict[str, dict[str, str]] = {}
    written = []
    for run_id in chosen:
        rows = run_rows(read_record(directory, run_id))
        machine = rows.run["machine"]
        if machine not in stored:
            stored[machine] = dict(store.digests(machine))
        if stored[machine].get(run_id) != rows.digest:
            store.put(rows)
            written.append(run_id)
    return tuple(written)


def end_of(row: RunRow) -> RunEnd | None:
    """Return the end of a run, or None while the run is in progress or can be resumed."""
    return (
        None if row.ended is None else RunEnd(utc_time(datetime.fromisoformat(row.ended)), row.state, row.reason or "")
    )
