"""Storage of the history of runs in a database.

Each run of a machine has one row in the table of runs. If the run has changed, its row is replaced.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from importlib import import_module
from typing import Any

from sqlalchemy import (
    Connection,
    Engine,
    Row,
    Select,
    Table,
    create_engine,
    delete,
    event,
    func,
    insert,
    inspect,
    select,
    text,
)
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from agent.history.database_url import DatabaseAddress
from agent.history.dated_ahead import latest_start
from agent.history.recent_runs import RecentRun, recent_runs_query
from agent.history.run_row import RunRows
from agent.history.run_selection import (
    NumberedRun,
    RunListing,
    RunSelection,
    VerdictGroup,
    conditions,
    counts,
    groups_query,
    numbered_runs_query,
)
from agent.history.schema import (
    DECISIONS,
    METADATA,
    PARAMETERS,
    RUNS,
    RUNS_BY_START,
    SCHEMA_VERSION,
    TEMPERATURES,
    VERSIONS,
    StoredDecision,
    StoredParameter,
    StoredRun,
    StoredTemperature,
    utc_time,
)
from agent.history.stored_rows import checked_rows, damage_of_history
from drivers.errors import ConfigurationError, LinkLost

_LOCK = 7_283_001
"""Key of the PostgreSQL advisory lock that is held while the tables are created or their version is checked."""
_CHILDREN: Mapping[str, tuple[Table, type[Any], str]] = {
    "parameters": (PARAMETERS, StoredParameter, "place"),
    "temperatures": (TEMPERATURES, StoredTemperature, "sensor"),
    "decisions": (DECISIONS, StoredDecision, "place"),
}
"""Table for each list of a `StoredRun`, with the class of its rows and the column by which the rows are sorted."""


@dataclass(frozen=True)
class RunEnd:
    """End of a run.

    `ended` is the UTC time of the end, or None if the run has not ended. `state` is the last state of the run, and
    `reason` is the reason for this state.
    """

    ended: datetime | None
    state: str
    reason: str


class HistoryStore:
    """Connection to the history database.

    Raises ConfigurationError if the database cannot be used, and LinkLost if it cannot be reached.
    """

    def __init__(self, address: DatabaseAddress) -> None:
        self.address = address
        with self._read_errors():
            self._engine = _engine(address)
            self._prepare()

    def close(self) -> None:
        self._engine.dispose()

    def digests(self, machine: str) -> Mapping[str, str]:
        """Return a mapping from the identity of each run of `machine` to the stored digest (hash of all values) of the
        run.
        """
        rows = self._read(select(RUNS.c.run_id, RUNS.c.digest).where(RUNS.c.machine == machine))
        return {run_id: digest for run_id, digest in rows}  # noqa: C416  a Row is no pair

    def ends(self, machine: str) -> Mapping[str, RunEnd]:
        """Return a mapping from the identity of each run of `machine` to the stored end of the run: its time, state and
        reason.
        """
        query = select(RUNS.c.run_id, RUNS.c.ended, RUNS.c.state, RUNS.c.reason)
        rows = self._read(query.where(RUNS.c.machine == machine))
        return {run_id: RunEnd(ended and utc_time(ended), state, reason) for run_id, ended, state, reason in rows}

    def dated_ahead(self, machine: str, now: datetime) -> frozenset[str]:
        """Return the identities of the runs of `machine` that are dated in the future at the time `now`."""
        query = select(RUNS.c.run_id).where(RUNS.c.machine == machine, RUNS.c.started > latest_start(now))
        return frozenset(run_id for (run_id,) in self._read(query))

    def put(self, rows: RunRows) -> None:
        """Insert `rows`, the rows of one run, into the database, or replace the stored rows of this run, in one
        transaction.
        """
        values = {**rows.run, "digest": rows.digest, **{at: _parse_time(rows.run[at]) for at in ("started", "ended")}}
        key = {name: values[name] for name in ("machine", "run_id")}
        with self._translated_errors(), self._engine.begin() as connection:
            connection.execute(_upsert(connection, values))
            decisions = [{**row, "at": _parse_time(row["at"])} for row in rows.decisions]
            for table, children in (
                (PARAMETERS, rows.parameters),
                (TEMPERATURES, rows.temperatures),
                (DECISIONS, decisions),
            ):
                of_run = (table.c.machine == key["machine"]) & (table.c.run_id == key["run_id"])
                connection.execute(delete(table).where(of_run))
                if children:
                    connection.execute(insert(table), [{**key, **row} for row in children])

    def machines(self) -> tuple[str, ...]:
        rows = self._read(select(RUNS.c.machine).distinct().order_by(RUNS.c.machine))
        return tuple(machine for (machine,) in rows)

    def runs(
        self,
        machine: str | None = None,
        last: int | None = None,
        *,
        whole: bool = True,
        only: Collection[str] | None = None,
    ) -> Sequence[StoredRun]:
        """Return the runs of one machine, the oldest run first. If `machine` is None, return the runs of all
        machines.

        If `last` is given, only the newest `last` runs are returned. If `whole` is False, the parameters, temperatures
        and decisions of the runs are left empty. If `only` is given, only runs with these identities are returned.
        """
        query = select(RUNS)
        if machine is not None:
            query = query.where(RUNS.c.machine == machine)
        if only is not None:
            query = query.where(RUNS.c.run_id.in_(only))
        query = query.order_by(RUNS.c.started.desc(), RUNS.c.run_id.desc()).limit(last)
        with self._read_errors(), self._engine.connect() as connection:
            found = checked_rows(StoredRun, connection.execute(query))[::-1]
            if whole:
                _add_children(connection, query, found)
        return found

    def listing(self, machine: str, selection: RunSelection, limit: int, offset: int) -> RunListing:
        """Return at most `limit` of the selected runs of one machine, the latest first, without the first `offset`
        ones. Their parameters, temperatures and decisions are left empty."""
        with self._read_errors(), self._engine.connect() as connection:
            groups = checked_rows(VerdictGroup, connection.execute(groups_query(machine)))
            numbers = numbered_runs_query(machine).subquery()
            chosen = (RUNS.c.machine == machine, *conditions(selection, groups))
            total = connection.execute(select(func.count()).where(*chosen)).scalar_one()
            query = select(numbers.c.number, RUNS).join(RUNS, RUNS.c.run_id == numbers.c.numbered).where(*chosen)
            query = query.order_by(numbers.c.number.desc()).limit(limit).offset(offset)
            rows = connection.execute(query).all()
            runs = checked_rows(StoredRun, [row[1:] for row in rows])
        kinds, verdicts = counts(groups)
        found = [NumberedRun(row.number, run) for row, run in zip(rows, runs, strict=True)]
        return RunListing(found, total, kinds, verdicts)

    def recent_runs(self, count: int, now: datetime) -> Sequence[RecentRun]:
        """Return the latest `count` runs of each machine, sorted by machine, the oldest run of a machine first. Of runs
        that started at the same instant as the first of these, all are returned. The latest `count` of the runs that
        are dated in the future at the time `now` are returned in addition."""
        with self._read_errors(), self._engine.connect() as connection:
            return checked_rows(RecentRun, connection.execute(recent_runs_query(count, latest_start(now))))

    def _read(self, query: Select[*tuple[Any, ...]]) -> Sequence[Row[*tuple[Any, ...]]]:
        with self._read_errors(), self._engine.connect() as connection:
            return connection.execute(query).all()

    def _prepare(self) -> None:
        """Create the tables if they are missing. Raise ConfigurationError if the schema version of existing tables is
        not supported.
        """
        with self._engine.begin() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            if not inspect(connection).has_table(VERSIONS.name):
                METADATA.create_all(connection)
                connection.execute(insert(VERSIONS), {"version": SCHEMA_VERSION})
            found = connection.execute(select(VERSIONS.c.version)).scalar_one()
            if found == SCHEMA_VERSION and not inspect(connection).has_index(RUNS.name, str(RUNS_BY_START.name)):
                _add_index(connection)
        if found != SCHEMA_VERSION:
            raise ConfigurationError(
                f"the history database has version {found}, this program supports version {SCHEMA_VERSION}",
                key="history.url",
                database=self.address.text,
                hint="install the newer version of volcal here" if found > SCHEMA_VERSION else "name a new database",
            )

    @contextmanager
    def _read_errors(self) -> Iterator[None]:
        """Convert the errors of a reading: those of the database, and values that were not stored so."""
        with damage_of_history(database=self.address.text), self._translated_errors():
            yield

    @contextmanager
    def _translated_errors(self) -> Iterator[None]:
        """Convert errors of SQLAlchemy in the block to ConfigurationError or LinkLost. Their messages do not contain
        the password.
        """
        try:
            yield
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"the driver for PostgreSQL is not installed: {error.name}",
                key="history.url",
                hint="install volcal with the extra `postgres`",
            ) from None
        except ArgumentError as error:
            raise ConfigurationError(f"the database URL cannot be used: {error}", key="history.url") from None
        except DBAPIError as error:
            raise self._lost(str(error.orig)) from None
        except SQLAlchemyError as error:
            raise self._lost(str(error)) from None

    def _lost(self, reason: str) -> LinkLost:
        first = reason.strip().splitlines()[0] if reason.strip() else "no reason given"
        password = self.address.url.password
        if password:
            first = first.replace(str(password), "***")
        return LinkLost(
            f"the history cannot be reached: {first}",
            database=self.address.text,
            hint="no data are lost: the journal has all runs, and `volcal history sync` copies them again",
        )


def stored_run(rows: RunRows) -> StoredRun:
    """Return the run that `rows` describes, as it would be read from the history database (`HistoryStore.runs`) after
    `rows` had been stored there (`HistoryStore.put`).

    No database is used.
    """
    moments = {at: _parse_time(rows.run[at]) for at in ("started", "ended")}
    key = {name: rows.run[name] for name in ("machine", "run_id")}
    return StoredRun(
        **{**rows.run, **moments, "digest": rows.digest},
        parameters=[StoredParameter(**key, **row) for row in rows.parameters],
        temperatures=[StoredTemperature(**key, **row) for row in rows.temperatures],
        decisions=[StoredDecision(**key, **{**row, "at": _parse_time(row["at"])}) for row in rows.decisions],
    )


def _add_children(connection: Connection, query: Select[Any], runs: Sequence[StoredRun]) -> None:
    """Add the rows of the other tables to the lists of `runs`, which were found by `query`."""
    by_key = {(run.machine, run.run_id): run for run in runs}
    found = query.with_only_columns(RUNS.c.machine, RUNS.c.run_id).subquery()
    for name, (table, row_type, order) in _CHILDREN.items():
        of_run = (table.c.machine == found.c.machine) & (table.c.run_id == found.c.run_id)
        lists = {key: getattr(run, name) for key, run in by_key.items()}
        read = connection.execute(select(table).join(found, of_run).order_by(table.c[order])).all()
        for row in checked_rows(row_type, read):
            rows = lists.get((row.machine, row.run_id))
            if rows is not None:  # None if another process has stored the run since
                rows.append(row)


def _add_index(connection: Connection) -> None:
    """Add the index to a database that an earlier program has created. Without the right to do so, reading is slower
    and nothing else."""
    with suppress(DBAPIError), connection.begin_nested():
        RUNS_BY_START.create(connection)


def _engine(address: DatabaseAddress) -> Engine:
    """Return an engine without a connection pool, since accesses are minutes apart and servers may be restarted in
    between.
    """
    seconds = address.timeout_s
    if address.is_file:
        engine = create_engine(address.url, poolclass=NullPool, connect_args={"timeout": seconds})
        event.listen(engine, "connect", _enforce_keys)
        event.listen(engine, "begin", _begin_writing)
        return engine
    wait = max(int(seconds), 1)
    options = f"-c statement_timeout={1000 * wait} -c lock_timeout={1000 * wait}"
    return create_engine(
        address.url,
        poolclass=NullPool,
        connect_args={"connect_timeout": wait, "options": options, "tcp_user_timeout": 1000 * wait},
    )


def _enforce_keys(connection: Any, _: object) -> None:
    connection.isolation_level = None  # transactions are started in `_begin_writing`, not by the driver
    connection.execute("PRAGMA foreign_keys=ON")


def _begin_writing(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _upsert(connection: Connection, values: Mapping[str, Any]) -> Any:
    dialect: Any = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")
    changed = {name: value for name, value in values.items() if name not in ("machine", "run_id")}
    return (
        dialect.insert(RUNS).values(**values).on_conflict_do_update(index_elements=["machine", "run_id"], set_=changed)
    )


def _parse_time(stamp: str | None) -> datetime | None:
    return None if stamp is None else datetime.fromisoformat(stamp)
