"""Runs that a journal has, as the history stores them, whether or not the history database can be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from agent.execution.run_record import RunHead, RunRecord, read_record, run_heads
from agent.history.database_url import address_of
from agent.history.run_row import machine_name, run_rows
from agent.history.schema import StoredRun, utc_time
from agent.history.store import HistoryStore, RunEnd, stored_run
from agent.history.sync import end_of
from agent.settings.history import HistorySettings
from drivers.errors import VolcalError


def runs_until(directory: Path, record: RunRecord, settings: HistorySettings) -> Sequence[StoredRun]:
    """Return the runs of one machine up to the run of `record`, the last one, in the order in which they started.

    The journal in the state directory `directory` decides which runs these are. A former run that the history file of
    `settings` has with the same end and the same settings is taken from there: it takes some 10 ms to read one from the
    journal, ten seconds after a thousand nights. The others are read from the journal. So are all if the file cannot be
    used, or if the history is on a server, where other machines write too.

    Raises InputError if the journal cannot be read.
    """
    machine = machine_name(record.settings)
    stored = _stored(directory, machine, settings)
    former = [
        _unchanged(head, stored) or stored_run(run_rows(read_record(directory, head.row.run_id)))
        for head in run_heads(directory)
        if head.row.run < record.ordinal and machine_name(head.settings) == machine
    ]
    return [*former, stored_run(run_rows(record))]


def _stored(directory: Path, machine: str, settings: HistorySettings) -> Mapping[str, StoredRun]:
    """Return the runs of the history file by their identity, or none if there is no such file or it cannot be used."""
    try:
        address = address_of(settings, machine, directory)
        if not address.is_file or not Path(address.url.database or "").is_file():
            return {}
        with closing(HistoryStore(address)) as store:
            return {run.run_id: run for run in store.runs(machine)}
    except VolcalError:  # the journal has all runs
        return {}


def _unchanged(head: RunHead, stored: Mapping[str, StoredRun]) -> StoredRun | None:
    """Return the stored run of `head`, or None if the journal has more or something else."""
    found, end = stored.get(head.row.run_id), end_of(head.row)
    if found is None or end is None or head.added_after_end:
        return None
    same_end = RunEnd(found.ended and utc_time(found.ended), found.state, found.reason) == end
    return found if same_end and found.settings_sha256 == head.settings_sha256 else None
