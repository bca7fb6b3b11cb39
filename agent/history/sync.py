"""Update of the history from the journal: adds runs that are missing or have changed since the last update."""

from __future__ import annotations

from pathlib import Path

from agent.execution.run_record import read_record, run_ids
from agent.history.run_row import run_rows
from agent.history.store import HistoryStore


def sync(directory: Path, store: HistoryStore) -> tuple[str, ...]:
    """Store all runs of the journal in the state directory; return the identities of those written, in order.

    May be repeated: runs that are stored and unchanged are skipped. Raise LinkLost if the connection to the database is
    lost; the next update continues from there.
    """
    stored: dict[str, dict[str, str]] = {}
    written = []
    for run_id in run_ids(directory):
        rows = run_rows(read_record(directory, run_id))
        machine = rows.run["machine"]
        known = stored.setdefault(machine, dict(store.digests(machine)))
        if known.get(run_id) != rows.digest:
            store.put(rows)
            written.append(run_id)
    return tuple(written)
