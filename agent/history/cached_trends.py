"""Cache of the runs of one machine and of their trends, which is kept up to date with the history database.

After a new run, only that run is read from the journal and from the database. The trends of the series to which it adds
a value are then fitted again, once for all readers of the cache.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from threading import Lock

from agent.history.database_url import database_address
from agent.history.overview import trends_of
from agent.history.schema import StoredRun, utc_time
from agent.history.store import HistoryStore
from agent.history.sync import sync_missing
from agent.history.trends import Trend
from agent.settings.history import HistorySettings
from agent.settings.schema import Settings


@dataclass(frozen=True, eq=False)
class MachineTrends:
    """All runs of `machine` in the history, the oldest run first, and the trends of all their series. `key` stands for
    the stored runs and the settings from which they were made."""

    machine: str
    runs: Sequence[StoredRun]
    trends: tuple[Trend, ...]
    key: object = None


class CachedTrends:
    """Trends of one machine. They are fitted again only if runs in the history or the settings of the history have
    changed. The cache is safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._database: object = None
        self._settings: HistorySettings | None = None
        self._current = MachineTrends("", (), ())

    def current(self, settings: Settings) -> MachineTrends:
        """Return the runs and trends of the machine, with all runs of the journal. Raise LinkLost or ConfigurationError
        if the history cannot be read.
        """
        with closing(HistoryStore(database_address(settings))) as store:
            sync_missing(settings.state_directory, store)
            return self.refreshed(store, settings.history)

    def key(self, settings: Settings) -> object:
        """Return the key of what `current` would return, without reading the runs. It is the same after a restart.
        Raises the same errors as `current`.
        """
        with closing(HistoryStore(database_address(settings))) as store:
            sync_missing(settings.state_directory, store)
            return _key(store, store.digests(store.address.machine), settings.history)

    def refreshed(self, store: HistoryStore, settings: HistorySettings) -> MachineTrends:
        """Return the runs of the machine that are stored in `store`, and their trends. The same object is returned as
        long as nothing has changed.
        """
        machine = store.address.machine
        database = (store.address.text, machine)
        with self._lock:
            digests = store.digests(machine)
            key = _key(store, digests, settings)
            if key != self._current.key:
                known = self._current.runs if database == self._database else ()
                runs = _updated(store, machine, known, digests)
                before = self._current.trends if (database, settings) == (self._database, self._settings) else ()
                self._current = MachineTrends(machine, runs, trends_of(runs, settings, before), key)
                self._database, self._settings = database, settings
            return self._current


@cache
def shared_trends() -> CachedTrends:
    """Return the cache of this process, which the page and the metrics share."""
    return CachedTrends()


def _key(store: HistoryStore, digests: Mapping[str, str], settings: HistorySettings) -> object:
    """Return what stands for the trends: the database, the runs, the settings, and the software that fits them."""
    address = store.address
    runs = tuple(sorted(digests.items()))
    return address.text, address.machine, settings.model_dump_json(), version("volcal"), runs


def _updated(
    store: HistoryStore, machine: str, known: Sequence[StoredRun], digests: Mapping[str, str]
) -> Sequence[StoredRun]:
    """Return all runs of the machine, the oldest run first. Runs of which `known` has the stored version are not read
    again."""
    unchanged = [run for run in known if digests.get(run.run_id) == run.digest]
    missing = digests.keys() - {run.run_id for run in unchanged}
    read = store.runs(machine, only=missing) if unchanged else store.runs(machine)
    return sorted((*unchanged, *read), key=lambda run: (utc_time(run.started), run.run_id))
