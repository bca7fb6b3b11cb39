"""Reader of the journal, the database of all runs. It returns typed rows, changes nothing and never delays the writer.

A method with the parameter `run` expects the number of a run in the journal (`RunRow.run`).

Some rows record steps that are not part of the procedure. For example, steps withdraw the probe and restore the table
if a run ends early, and steps move the probe back if the run is resumed.

A compacted run reads as it did before: its steps, balls and temperatures are unpacked into temporary tables in memory.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from agent.execution import journal_queries as queries
from agent.execution.journal_rows import (
    AlarmRow,
    BallRow,
    DecisionRow,
    EventRow,
    OriginRow,
    RunCounts,
    RunRow,
    StepRow,
    TableRow,
    TemperatureRow,
    TouchRow,
)
from agent.execution.journal_schema import FILE_NAME, is_empty, require_version
from agent.execution.packed_run import PackedRun, expand_stored_text
from agent.execution.stored_json import damage_reported
from drivers.errors import ConfigurationError, InputError, VolcalError
from drivers.foreign_errors import cause_of

if TYPE_CHECKING:
    from drivers.roles import TableImage

Row = TypeVar("Row")

ANY_RUN = 2**62
"""Greater than the number of any run."""

WORKING_STEPS = frozenset({"TouchTowards", "StageTable", "ActivateBank"})
"""Types of the steps that measure or that change the compensation. A run without such a step leaves everything as an
earlier run has left it."""

_TIMEOUT_S = 2.0


def has_journal(directory: Path) -> bool:
    """Return True if the state directory `directory` contains a journal; there is none before the first run.

    A file without tables, which a full disk or a power cut can leave, is no journal yet: the next run creates its
    tables. The same holds while the creation that was interrupted has not been rolled back. A file that cannot be read
    is one, and the functions that read it say what is wrong.
    """
    path = directory / FILE_NAME
    if not path.is_file():
        return False
    try:
        with connected(path) as connection:
            return not is_empty(connection)
    except sqlite3.Error as error:
        return not _is_to_be_rolled_back(error)


def _is_to_be_rolled_back(error: sqlite3.Error) -> bool:
    """Return True if reading has failed because the creation of the database was interrupted, and only a writer can
    roll it back. Later the database has a write-ahead log, which readers recover themselves."""
    return getattr(error, "sqlite_errorname", None) == "SQLITE_READONLY_ROLLBACK"  # Python's own errors have no name


@contextmanager
def connected(path: Path, option: str = "mode=ro") -> Iterator[sqlite3.Connection]:
    """Yield a connection to the existing journal `path`, which is closed at the end of the `with` block. `option` is
    the mode of SQLite's URI."""
    uri = f"{path.resolve().as_uri()}?{option}"
    with closing(sqlite3.connect(uri, uri=True, timeout=_TIMEOUT_S)) as connection:
        yield connection


def require_same_version(directory: Path) -> None:
    """Raise ConfigurationError if the state directory contains a journal of a different version of volcal. The file is
    not changed, not even as SQLite changes a file that is opened for writing, unless its creation was interrupted."""
    path = directory / FILE_NAME
    if not path.is_file():
        return
    try:
        with connected(path) as connection:
            require_version(connection, path, ConfigurationError)
    except sqlite3.OperationalError as error:
        if not _is_to_be_rolled_back(error):
            raise
        with connected(path, "mode=rw") as connection:
            require_version(connection, path, ConfigurationError)


@contextmanager
def open_journal(directory: Path, failure: type[VolcalError] = InputError) -> Iterator[JournalReader]:
    """Yield a reader of the journal in the state directory `directory`. The journal is open during the `with` block and
    is not changed.

    Raises an error of the class `failure` if there is no journal, if it has a different version, or if it cannot be
    read at the start or later in the block.
    """
    path = directory / FILE_NAME
    try:
        with connected(path) as connection:
            require_version(connection, path, failure)
            if is_empty(connection):
                raise failure("the journal has no run yet", hint="the first run fills it", file=str(path))
            with damage_reported(failure, path):
                yield JournalReader(connection, path)
    except sqlite3.Error as error:
        raise failure(f"the journal cannot be read: {cause_of(error)}", file=str(path)) from error


class JournalReader:
    """Reader of a journal through an SQLite connection that the caller opens and closes.

    The connection may be that of the object that writes the journal, or a connection to a database in memory. `path` is
    used only in error messages.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path = Path(FILE_NAME)) -> None:
        self._connection = connection
        self._path = path

    def run_ids(self) -> tuple[str, ...]:
        """Return the identities of all runs in the order in which the runs started."""
        return self._rows(str, "SELECT run_id FROM runs ORDER BY run")

    def runs(self) -> tuple[RunRow, ...]:
        """Return the rows of all runs in the order in which the runs started."""
        return self._rows(RunRow, queries.RUN + "ORDER BY run")

    def run(self, run_id: str) -> RunRow | None:
        return self._first(RunRow, queries.RUN + "WHERE run_id = :run_id", run_id=run_id)

    def require_run(self, run_id: str) -> RunRow:
        """Return the row of the run with the identity `run_id`.

        Raises InputError, which names the latest runs, if the journal has no such run.
        """
        run = self.run(run_id)
        if run is None:
            last = self.run_ids()[:-4:-1]
            hint = f"the last ones are: {', '.join(last)}" if last else "it has no run yet"
            raise InputError(f"the journal has no run {run_id}", file=str(self._path), hint=hint)
        return run

    def last_run(self) -> RunRow | None:
        return self._first(RunRow, queries.RUN + "ORDER BY run DESC LIMIT 1")

    def latest_begun_runs(self) -> Iterator[RunRow]:
        """Yield the rows of all runs that recorded a step or passed their preflight, the latest first."""
        for row in self._connection.execute(queries.BEGUN_RUNS.format(compacted=self._compacted())):
            yield RunRow(*row)

    def latest_started_runs(self) -> Iterator[RunRow]:
        """Yield the row of a run for each time that it was started or resumed, the latest time first."""
        for row in self._connection.execute(queries.STARTED_RUNS):
            yield RunRow(*row)

    def has_step_below(self, run: int, start: str) -> bool:
        """Return True if the run has recorded a step whose key begins with `start`."""
        return bool(self._measured(queries.HAS_STEP_BELOW, run, start=start))

    def has_worked(self, run: int) -> bool:
        """Return True if the run has begun to measure or to write tables."""
        return bool(self._measured(queries.HAS_STEP, run, kinds=_listed(WORKING_STEPS)))

    def run_counts(self, limit: int, before_run: int = ANY_RUN) -> tuple[RunCounts, ...]:
        """Return the rows of at most `limit` runs, the latest first, each with the number of its measured balls and the
        number of its touches.

        Only runs with a number below `before_run` are returned.
        """
        query = queries.COUNTS + "WHERE run < :before ORDER BY run DESC LIMIT :limit"
        with self._one_state():
            rows = self._all(query.format(compacted=self._compacted()), before=before_run, limit=limit)
        return tuple(RunCounts(RunRow(*run), balls, touches) for *run, balls, touches in rows)

    def added_after_end(self) -> frozenset[int]:
        """Return the numbers of the runs to which decisions or tables were added after their end, for example because
        the next start took back a table that was never proved. The outcome, which every run writes just after its end,
        does not count."""
        return frozenset(self._rows(int, queries.ADDED_AFTER_END))

    def settings_text(self, run: int) -> str:
        """Return the settings with which the run number `run` was started, as JSON text."""
        return str(self._value("SELECT settings FROM runs WHERE run = :run", run=run))

    def origin(self, run: int) -> OriginRow | None:
        return self._first(OriginRow, queries.ORIGIN, run=run)

    def steps(self, run: int, kind: str | None = None, *, procedure_only: bool = False) -> tuple[StepRow, ...]:
        """Return the steps of a run in the order in which they were recorded.

        If `kind` is given, only steps whose class has this name are returned, such as ``TouchTowards``. If
        `procedure_only` is True, steps that are not part of the procedure are omitted, for example steps that withdraw
        the probe at the end of a run.
        """
        aside = " AND NOT aside" if procedure_only else ""
        query = queries.STEP + f"WHERE run = :run AND (:kind IS NULL OR kind = :kind){aside} ORDER BY ordinal"
        rows = self._measured(query, run, kind=kind)
        return tuple(StepRow(*row) for row in rows)

    def count_steps(self, run: int) -> int:
        return int(self._measured_value("SELECT count(*) FROM {at}steps WHERE run = :run", run))

    def last_step_key(self, run: int) -> str | None:
        """Return the key of the step that began last in the run; None if no step has begun."""
        rows = self._measured("SELECT key FROM {at}steps WHERE run = :run ORDER BY ordinal DESC LIMIT 1", run)
        return str(rows[0][0]) if rows else None

    def ordinal_of(self, run: int, key: str) -> int:
        """Return the sequence number of the last step `key` of the procedure of the run."""
        query = "SELECT max(ordinal) FROM {at}steps WHERE run = :run AND key = :key AND aside = 0"
        return int(self._measured_value(query, run, key=key))

    def time_span_s(self, run: int) -> tuple[float, float] | None:
        """Return a pair of machine times in s: the time at which the run's first step began, and the time at which its
        last step ended. Return None if there is no step.

        If a step did not end, the time at which it began is used instead.
        """
        query = "SELECT min(begun), max(coalesce(finished, begun)) FROM {at}steps WHERE run = :run"
        [(first, last)] = self._measured(query, run)
        return None if first is None else (first, last)

    def last_ordinal(self, run: int) -> int:
        """Return the largest sequence number (ordinal) of the run's steps and balls; 0 if there are none."""
        steps = "SELECT coalesce(max(ordinal), 0) FROM {at}steps WHERE run = :run"
        balls = "SELECT coalesce(max(ordinal), 0) FROM {at}balls WHERE run = :run"
        return max(int(self._measured_value(steps, run)), int(self._measured_value(balls, run)))

    def touches(self, run: int) -> tuple[TouchRow, ...]:
        """Return the touches of a run that have a result. Touches that are not part of the procedure of the run are
        omitted.
        """
        query = "SELECT ordinal, key, finished, result " + queries.TOUCH + "ORDER BY ordinal"
        return tuple(TouchRow(*row) for row in self._measured(query, run))

    def count_touches(self, run: int) -> int:
        """Return the number of touches of a run that have a result and are part of the procedure of the run."""
        return int(self._measured_value("SELECT count(*) " + queries.TOUCH, run))

    def balls(self, run: int) -> tuple[BallRow, ...]:
        """Return the measured ball centres of a run in the order of measurement. The run may still be in progress."""
        query = "SELECT ordinal, key, record FROM {at}balls WHERE run = :run ORDER BY ordinal"
        return tuple(BallRow(*row) for row in self._measured(query, run))

    def count_balls(self, run: int) -> int:
        return int(self._measured_value("SELECT count(*) FROM {at}balls WHERE run = :run", run))

    def temperatures(self, run: int) -> tuple[TemperatureRow, ...]:
        """Return the temperature readings of a run in the order in which they were made, without those that the run has
        rejected, which are named by events with the field `rejected`."""
        return tuple(TemperatureRow(*row) for row in self._measured(queries.TEMPERATURE, run))

    def events(
        self,
        run: int,
        kinds: Collection[str] | None = None,
        *,
        after: int = 0,
        limit: int = -1,
        procedure_only: bool = False,
    ) -> tuple[EventRow, ...]:
        """Return the events of a run with row numbers greater than `after`, in the order written.

        If `kinds` is None, events of all kinds are returned. `limit` is the largest number of events returned. If
        `limit` is negative, the number is not limited.
        """
        query = _restricted(queries.EVENT, procedure_only)
        return self._rows(EventRow, query, run=run, kinds=_listed(kinds), after=after, limit=limit)

    def last_event_number(self, run: int, kind: str) -> int:
        """Return the row number of the last event of the kind `kind` in the run; 0 if there is none."""
        query = "SELECT coalesce(max(rowid), 0) FROM events WHERE run = :run AND kind = :kind"
        return int(self._value(query, run=run, kind=kind))

    def alarms(self, limit: int, offset: int = 0) -> tuple[AlarmRow, ...]:
        """Return at most `limit` alarms, those of all runs and those between runs, the latest first, without the first
        `offset` ones.

        An error that ended a run counts as an alarm if the service has recorded none, as with runs of the command line.
        """
        return self._rows(AlarmRow, queries.ALARM.format(idle=self._idle_alarms()), limit=limit, offset=offset)

    def count_alarms(self) -> int:
        return int(self._value(queries.ALARM_COUNT.format(idle=self._idle_alarms())))

    def open_idle_alarms(self) -> tuple[AlarmRow, ...]:
        """Return the alarms between runs of which no end is recorded, the first one first."""
        return self._rows(AlarmRow, queries.OPEN_IDLE_ALARM.format(idle=self._idle_alarms()))

    def decisions(self, run: int, *, procedure_only: bool = False) -> tuple[DecisionRow, ...]:
        query = queries.DECISION + "WHERE run = :run{aside} ORDER BY decisions.rowid"
        return self._rows(DecisionRow, _restricted(query, procedure_only), run=run)

    def decision(self, run: int, kind: str) -> DecisionRow | None:
        """Return the last decision of the kind `kind` in the run; None if there is none."""
        query = queries.DECISION + "WHERE run = :run AND decisions.kind = :kind ORDER BY decisions.rowid DESC LIMIT 1"
        return self._first(DecisionRow, query, run=run, kind=kind)

    def decision_records(self, run: int) -> Callable[[str], Mapping[str, Any] | None]:
        """Return a function that returns the content of the run's last decision of a kind; None if there is none."""

        def record(kind: str) -> Mapping[str, Any] | None:
            row = self.decision(run, kind)
            return None if row is None else row.record

        return record

    def has_decision(self, run: int, kinds: Collection[str]) -> bool:
        query = "SELECT 1 FROM decisions WHERE run = :run AND kind IN (SELECT value FROM json_each(:kinds)) LIMIT 1"
        return self._one(query, run=run, kinds=_listed(kinds)) is not None

    def last_decision(self, kind: str, before_run: int = ANY_RUN) -> DecisionRow | None:
        """Return the last decision of the kind `kind` that any run recorded; None if there is none.

        Only decisions of runs with a number below `before_run` are considered.
        """
        query = (
            queries.DECISION + "WHERE decisions.kind = :kind AND run < :before ORDER BY decisions.rowid DESC LIMIT 1"
        )
        return self._first(DecisionRow, query, kind=kind, before=before_run)

    def estimates(self, run: int) -> tuple[str, ...]:
        """Return the JSON texts of the run's estimates of the machine's errors, in the order written."""
        query = "SELECT record FROM estimates WHERE run = :run ORDER BY rowid"
        return self._rows(expand_stored_text, query, run=run)

    def last_estimate(self, run: int) -> str | None:
        """Return the JSON text of the run's last estimate of the machine's errors; None if there is none."""
        query = "SELECT record FROM estimates WHERE run = :run ORDER BY rowid DESC LIMIT 1"
        return self._first(expand_stored_text, query, run=run)

    def tables(self, run: int, *, procedure_only: bool = False) -> tuple[TableRow, ...]:
        """Return the rows of the compensation tables that a run stored, in the order written."""
        query = queries.TABLE + "WHERE run = :run{aside} ORDER BY tables.rowid"
        return self._rows(TableRow, _restricted(query, procedure_only), run=run)

    def latest_tables(self, limit: int) -> tuple[TableRow, ...]:
        """Return the rows of the latest compensation tables stored by any run, at most `limit` of them, the latest
        first.
        """
        return self._rows(TableRow, queries.TABLE + "ORDER BY tables.rowid DESC LIMIT :limit", limit=limit)

    def last_table(self, run: int, role: str) -> TableRow | None:
        query = queries.TABLE + "WHERE run = :run AND role = :role ORDER BY tables.rowid DESC LIMIT 1"
        return self._first(TableRow, query, run=run, role=role)

    def last_backup(self, run: int | None = None) -> TableRow | None:
        """Return the journal row of the backup that the run number `run` stored, or None if there is none. The backup
        is the compensation table that was read from the controller before anything was written.

        If `run` is None, the backup of the run that was started or resumed last is returned, among the runs that
        stored one.
        """
        return self._first(TableRow, queries.LAST_BACKUP, run=run)

    def last_active_table(self, accepting: Collection[str]) -> TableRow | None:
        """Return the row of the stored compensation table that should be active in the controller; None if there is
        none.

        It belongs to the run of `last_backup`. This is the staged table, which its run wrote to the controller, if the
        run has a decision of one of the kinds `accepting`. Otherwise it is the restored table (made active again), or
        the backup (read before anything was written).
        """
        backup = self.last_backup()
        if backup is None:
            return None
        staged = self.last_table(backup.run, "staged")
        if staged is not None and self.has_decision(backup.run, accepting):
            return staged
        return self.last_table(backup.run, "restored") or backup

    def image(self, table: TableRow) -> TableImage | None:
        """Return the whole compensation table that the row `table` describes; None if the row describes an empty table
        memory of the controller.
        """
        return self._image("rowid = :number", number=table.number)

    def image_with_digest(self, run: int, crc32: int) -> TableImage | None:
        """Return the compensation table with the checksum `crc32` that the run number `run` stored; None if there is
        none.
        """
        return self._image("run = :run AND crc32 = :crc32 AND counts IS NOT NULL", run=run, crc32=crc32)

    def compacted_runs(self) -> frozenset[int]:
        """Return the numbers of the runs whose records are stored in packed form."""
        with self._one_state():
            return frozenset(self._rows(int, f"SELECT run FROM {self._compacted()}"))  # noqa: S608  our own names

    def copy_to(self, path: Path) -> None:
        """Write a consistent copy of the journal to the new file `path`. A run may write to the journal during the
        copy.
        """
        self._connection.execute("VACUUM INTO ?", (str(path),))

    def _image(self, where: str, **values: int) -> TableImage | None:
        row = self._one(queries.IMAGE + where + " LIMIT 1", **values)
        if row is None or row[-1] is None:
            return None
        from agent.execution.encoding import decode_table  # noqa: PLC0415  numpy is needed for whole tables only

        return decode_table(*row)

    def _measured(self, query: str, run: int, **values: str | None) -> list[tuple[Any, ...]]:
        """Return the rows of a statement on the steps, balls and temperatures of one run, compacted or not."""
        with self._one_state():
            content = self._one(queries.CONTENT.format(compacted=self._compacted()), run=run)
            if content is not None:
                self._unpack(run, content[0])
            at = "" if content is None else queries.UNPACKED
            return self._all(query.format(at=at), run=run, **values)

    def _measured_value(self, query: str, run: int, **values: str | None) -> Any:
        return self._measured(query, run, **values)[0][0]

    @contextmanager
    def _one_state(self) -> Iterator[None]:
        """Read one state of the journal in the `with` block: a run may be compacted between two statements."""
        if self._connection.in_transaction:
            yield
            return
        self._connection.execute("BEGIN")
        try:
            yield
        finally:
            if self._connection.in_transaction:  # SQLite ends it on its own after some errors
                self._connection.execute("COMMIT")

    def _compacted(self) -> str:
        return self._table(queries.COMPACTED, queries.NONE_COMPACTED)

    def _idle_alarms(self) -> str:
        return self._table(queries.IDLE_ALARMS, queries.NO_IDLE_ALARMS)

    def _table(self, name: str, empty: str) -> str:
        """Return the table `name`, or the `empty` one if an earlier program wrote the journal."""
        query = "SELECT 1 FROM main.sqlite_master WHERE name = :name"
        return empty if self._one(query, name=name) is None else name

    def _unpack(self, run: int, content: bytes) -> None:
        """Fill the temporary tables with the rows of a compacted run, unless they have them already."""
        for statement in queries.UNPACKED_TABLES:
            self._connection.execute(statement)
        if self._one("SELECT 1 FROM temp.unpacked_runs WHERE run = :run", run=run) is not None:
            return
        packed = PackedRun.unpacked(content)
        for table in ("runs", *queries.PACKED_COLUMNS):
            self._connection.execute(f"DELETE FROM temp.unpacked_{table}")  # noqa: S608  our own names
        for table, columns in queries.PACKED_COLUMNS.items():
            marks = ", ".join("?" for _ in columns.split(", "))
            statement = f"INSERT INTO temp.unpacked_{table} VALUES ({run}, {marks})"  # noqa: S608  our own names
            self._connection.executemany(statement, packed.rows[table])
        self._connection.execute("INSERT INTO temp.unpacked_runs VALUES (?)", (run,))

    def _rows(self, row_type: Callable[..., Row], query: str, **values: str | int | None) -> tuple[Row, ...]:
        return tuple(row_type(*row) for row in self._all(query, **values))

    def _first(self, row_type: Callable[..., Row], query: str, **values: str | int | None) -> Row | None:
        row = self._one(query, **values)
        return None if row is None else row_type(*row)

    def _all(self, query: str, **values: str | int | None) -> list[tuple[Any, ...]]:
        return self._connection.execute(query, values).fetchall()

    def _one(self, query: str, **values: str | int | None) -> tuple[Any, ...] | None:
        row: tuple[Any, ...] | None = self._connection.execute(query, values).fetchone()
        return row

    def _value(self, query: str, **values: str | int | None) -> Any:
        return self._connection.execute(query, values).fetchone()[0]


def _restricted(query: str, procedure_only: bool) -> str:
    """Return the statement without rows of withdrawals and returns if `procedure_only`."""
    return query.format(aside=" AND NOT aside" if procedure_only else "")


def _listed(kinds: Collection[str] | None) -> str | None:
    """Return a list of kinds as one JSON parameter; None for all kinds."""
    return None if kinds is None else json.dumps(sorted(kinds))
