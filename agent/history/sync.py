"""History fed from the journal: whatever is missing there or has changed since, however long the database was away."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import structlog

from agent.execution.run_record import read_record, run_ids
from agent.history.database_url import place_of
from agent.history.run_row import fed_run
from agent.history.store import HistoryStore
from agent.settings.schema import Settings
from drivers.errors import VolcalError

log = structlog.get_logger()


def sync(directory: Path, store: HistoryStore) -> tuple[str, ...]:
    """Feed all runs of the journal in the state directory; the ones that were written, in their order.

    Again and again without harm: what is stored and has not changed is left alone. LinkLost where the database goes
    away on the way; the next time goes on from there.
    """
    stored: dict[str, dict[str, str]] = {}
    written = []
    for run_id in run_ids(directory):
        fed = fed_run(read_record(directory, run_id))
        machine = fed.run["machine"]
        known = stored.setdefault(machine, dict(store.digests(machine)))
        if known.get(run_id) != fed.digest:
            store.put(fed)
            written.append(run_id)
    return tuple(written)


def feed(settings: Settings, run_id: str) -> str:
    """After a run: feed history, this run and whatever is missing. The complaint where that failed, else empty; a run
    is never disturbed by it."""
    try:
        with closing(HistoryStore(place_of(settings))) as store:
            written = sync(settings.state_directory, store)
    except VolcalError as error:
        log.warning("history not fed", run=run_id, reason=str(error))
        return f"history was not fed: {error}"
    log.info("history fed", run=run_id, runs=len(written))
    return ""
