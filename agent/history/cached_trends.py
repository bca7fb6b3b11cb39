"""Cache of the runs of one machine and of their trends, which is kept up to date with the history database.

After a new run, only that run is read from the journal and from the database. The trends of the series to which it adds
a value are then fitted again, once for all readers of the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from importlib.metadata import version
from threading import Lock

from agent.history.database_url import database_address
from agent.history.dated_ahead import RunsByDate, by_date
from agent.history.overview import trends_of
from agent.history.schema import StoredRun, utc_time
from agent.history.store import HistoryStore
from agent.history.sync import sync_missing
from agent.history.trends import Trend
from agent.settings.history import HistorySettings
from agent.settings.schema import Settings
from drivers.clock import utc_timestamp


def _utc_now() -> datetime:
    return datetime.fromisoformat(utc_timestamp())


@dataclass(frozen=True, eq=False)
class MachineTrends:
    """All runs of `machine` in the history, and the trends of all series of those that count. `key` stands for the
    stored runs, those of them that are dated in the future, and the settings from which the trends were made."""

    machine: str
    by_date: RunsByDate[StoredRun]
    trends: tuple[Trend, ...]
    key: object = None

    @property
    def runs(self) -> Sequence[StoredRun]:
        """All runs, the oldest run first."""
        return self.by_date.every


class CachedTrends:
    """Trends of one machine. They are fitted again only if runs in the history or the settings of the history have
    changed, or if the date of a run has come that was in the future. `now` returns the UTC time. The cache is safe to
    use from any thread."""

    def __init__(self, now: Callable[[], datetime] = _utc_now) -> None:
        self._now = now
        self._lock = Lock()
        self._database: object = None
        self._settings: HistorySettings | None = None
        self._current = MachineTrends("", RunsByDate((), (), ()), ())

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
            machine = store.address.machine
            return _key(store, store.digests(machine), store.dated_ahead(machine, self._now()), settings.history)

    def refreshed(self, store: HistoryStore, settings: HistorySettings) -> MachineTrends:
        """Return the runs of the machine that are stored in `store`, and their trends. The same object is returned as
        long as nothing has changed.
        """
        machine = store.address.machine
        database = (store.address.text, machine)
        with self._lock:
            now, digests = self._now(), store.digests(machine)
            key = _key(store, digests, store.dated_ahead(machine, now), settings)
            if key != self._current.key:
                known = self._current.runs if database == self._database else ()
                dated = by_date(_updated(store, machine, known, digests), now)
                before = self._current.trends if (database, settings) == (self._database, self._settings) else ()
                self._current = MachineTrends(machine, dated, trends_of(dated.counted, settings, before), key)
                self._database, self._settings = database, settings
            return self._current


@cache
def shared_trends() -> CachedTrends:
    """Return the cache of this process, which the page and the metrics share."""
    return CachedTrends()


def _key(store: HistoryStore, digests: Mapping[str, str], ahead: Collection[str], settings: HistorySettings) -> object:
    """Return what stands for the trends: the database, the runs and which of them are dated in the future (`ahead`),
    the settings, and the software that fits them."""
    address = store.address
    runs = tuple(sorted(digests.items()))
    return address.text, address.machine, settings.model_dump_json(), version("volcal"), runs, tuple(sorted(ahead))


def _updated(
    store: HistoryStore, machine: str, known: Sequence[StoredRun], digests: Mapping[str, str]
) -> Sequence[StoredRun]:
    """Return all runs of the machine, the oldest run first. Runs of which `known` has the stored version are not read
    again."""
    unchanged = [run for run in known if digests.get(run.run_id) == run.digest]
    missing = digests.keys() - {run.run_id for run in unchanged}
    read = store.runs(machine, only=missing) if unchanged else store.runs(machine)
    return sorted((*unchanged, *read), key=lambda run: (utc_time(run.started), run.run_id))
