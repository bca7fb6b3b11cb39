"""Storage of the history in its database: one row per machine and run, which may be rewritten."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, delete, event, insert, inspect, select, text
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import ArgumentError, DBAPIError, SQLAlchemyError
from sqlalchemy.orm import Session, selectinload
from sqlalchemy.pool import NullPool

from agent.history.database_url import DatabaseAddress
from agent.history.run_row import RunRows
from agent.history.schema import (
    SCHEMA_VERSION,
    Base,
    SchemaVersion,
    StoredDecision,
    StoredParameter,
    StoredRun,
    StoredTemperature,
)
from drivers.errors import ConfigurationError, LinkLost

_LOCK = 7_283_001
"""Key of the PostgreSQL advisory lock held while creating or changing the tables."""
_CHILDREN = (StoredParameter, StoredTemperature, StoredDecision)


class HistoryStore:
    """Open history database. Raise ConfigurationError if it cannot be used, LinkLost if it cannot be reached."""

    def __init__(self, address: DatabaseAddress) -> None:
        self.address = address
        with self._translated_errors():
            self._engine = _engine(address)
            self._prepare()

    def close(self) -> None:
        self._engine.dispose()

    def digests(self, machine: str) -> Mapping[str, str]:
        """Return the stored digest of each run of the machine."""
        with self._translated_errors(), Session(self._engine) as session:
            rows = session.execute(select(StoredRun.run_id, StoredRun.digest).where(StoredRun.machine == machine))
            return {run_id: digest for run_id, digest in rows}  # noqa: C416  a Row is no pair

    def put(self, rows: RunRows) -> None:
        """Insert or replace the rows of a run in one transaction."""
        values = {**rows.run, "digest": rows.digest, **{at: _parse_time(rows.run[at]) for at in ("started", "ended")}}
        key = {name: values[name] for name in ("machine", "run_id")}
        with self._translated_errors(), self._engine.begin() as connection:
            connection.execute(_upsert(connection, values))
            for table in _CHILDREN:
                connection.execute(delete(table).where(table.machine == key["machine"], table.run_id == key["run_id"]))
            decisions = [{**row, "at": _parse_time(row["at"])} for row in rows.decisions]
            for child, children in zip(_CHILDREN, (rows.parameters, rows.temperatures, decisions), strict=True):
                if children:
                    connection.execute(insert(child), [{**key, **row} for row in children])

    def machines(self) -> tuple[str, ...]:
        with self._translated_errors(), Session(self._engine) as session:
            return tuple(session.scalars(select(StoredRun.machine).distinct().order_by(StoredRun.machine)))

    def runs(self, machine: str | None = None, last: int | None = None) -> Sequence[StoredRun]:
        """Return the runs of a machine, or of all, oldest first, with all their rows; `last`: at most the latest so
        many."""
        query = select(StoredRun).options(
            selectinload(StoredRun.parameters), selectinload(StoredRun.temperatures), selectinload(StoredRun.decisions)
        )
        if machine is not None:
            query = query.where(StoredRun.machine == machine)
        query = query.order_by(StoredRun.started.desc(), StoredRun.run_id.desc()).limit(last)
        with self._translated_errors(), Session(self._engine) as session:
            found = list(session.scalars(query))
            session.expunge_all()
            return found[::-1]

    def _prepare(self) -> None:
        """Create the tables, or check that their version is supported."""
        with self._engine.begin() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            if not inspect(connection).has_table(SchemaVersion.__tablename__):
                Base.metadata.create_all(connection)
                connection.execute(insert(SchemaVersion), {"version": SCHEMA_VERSION})
            found = connection.execute(select(SchemaVersion.version)).scalar_one()
        if found != SCHEMA_VERSION:
            raise ConfigurationError(
                f"the history database has version {found}, this program supports version {SCHEMA_VERSION}",
                key="history.url",
                database=self.address.text,
                hint="install the newer version of volcal here" if found > SCHEMA_VERSION else "name a new database",
            )

    @contextmanager
    def _translated_errors(self) -> Iterator[None]:
        """Convert errors of the library to errors of the error tree, without the password."""
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
    """Return the row that `put` would store, without a database."""
    moments = {at: _parse_time(rows.run[at]) for at in ("started", "ended")}
    key = {name: rows.run[name] for name in ("machine", "run_id")}
    run = StoredRun(**{**rows.run, **moments, "digest": rows.digest})
    run.parameters = [StoredParameter(**key, **row) for row in rows.parameters]
    run.temperatures = [StoredTemperature(**key, **row) for row in rows.temperatures]
    run.decisions = [StoredDecision(**key, **{**row, "at": _parse_time(row["at"])}) for row in rows.decisions]
    return run


def _engine(address: DatabaseAddress) -> Engine:
    """Return an engine without connection pool: accesses are minutes apart, and servers are restarted."""
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
    dialect: Any = postgresql if connection.dialect.name == "postgresql" else sqlite
    changed = {name: value for name, value in values.items() if name not in ("machine", "run_id")}
    return (
        dialect.insert(StoredRun)
        .values(**values)
        .on_conflict_do_update(index_elements=["machine", "run_id"], set_=changed)
    )


def _parse_time(stamp: str | None) -> datetime | None:
    return None if stamp is None else datetime.fromisoformat(stamp)
