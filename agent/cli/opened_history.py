"""History of runs, opened for a command and updated from the journal of this machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import datetime
from pathlib import Path

import click

from agent.history.database_url import database_address
from agent.history.dated_ahead import ahead_text, by_date
from agent.history.schema import StoredRun
from agent.history.store import HistoryStore
from agent.history.sync import sync_ends
from agent.settings.load import naming, read_settings
from agent.settings.schema import Settings
from drivers.clock import utc_timestamp
from drivers.errors import InputError


@contextmanager
def opened_history(config: Path) -> Iterator[tuple[Settings, HistoryStore]]:
    """Yield the settings and the open history store. The store is first updated from the journal of this machine.

    If the journal is missing, no error is raised.
    """
    with naming(config):
        settings = read_settings(config)
        with closing(HistoryStore(database_address(settings))) as store:
            try:
                sync_ends(settings.state_directory, store)
            except InputError as error:
                click.echo(f"note: {error}", err=True)
            yield settings, store


def counted_runs(store: HistoryStore) -> Sequence[StoredRun]:
    """Return the runs of this machine, the oldest first, without those that are dated in the future, which a note on
    stderr names."""
    runs = by_date(store.runs(store.address.machine), datetime.fromisoformat(utc_timestamp()))
    if runs.ahead:
        click.echo(f"note: {ahead_text(runs.ahead)}", err=True)
    return runs.counted
