"""History fed from the journal: whatever is missing there or has changed since, however long the database was away."""

from __future__ import annotations

from pathlib import Path

from agent.execution.run_record import read_record, run_ids
from agent.history.run_row import run_rows
from agent.history.store import HistoryStore


def sync(directory: Path, store: HistoryStore) -> tuple[str, ...]:
    """Feed all runs of the journal in the state directory; the ones that were written, in their order.

    Again and again without harm: what is stored and has not changed is left alone. LinkLost where the database goes
    away on the way; the next time goes on from there.
    """
    stored: dict[str, dict[str, str]] = {}
    written = []
    for run_id in run_ids(directory):
        fed = run_rows(read_record(directory, run_id))
        machine = fed.run["machine"]
        known = stored.setdefault(machine, dict(store.digests(machine)))
        if known.get(run_id) != fed.digest:
            store.put(fed)
            written.append(run_id)
    return tuple(written)
