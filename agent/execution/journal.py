"""Writer of the journal, which is one SQLite database in the state directory and the only authoritative record of runs.

The database uses a write-ahead log (WAL) with ``synchronous=FULL``: the data of a commit are on the disk when the
commit returns. With ``synchronous=NORMAL``, a power cut can lose commits although the integrity check still reports ok.

A step that moves or changes something is recorded durably before it begins. Its result is recorded durably before the
plan is asked for its next step.
"""

from __future__ import annotations

import copy
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from agent.errors import Busy, JournalFailed, PlanRefused, RunError
from agent.execution.encoding import encode_result, encode_step, table_digest, to_json
from agent.execution.journal_reader import WORKING_STEPS, JournalReader, require_same_version
from agent.execution.journal_schema import FILE_NAME, prepare
from agent.execution.replay_log import ReplayLog, comparable_estimate, read_replay_log
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, ReadTemperatures, Record, Step
from agent.files import create_directory
from drivers.clock import Clock, utc_timestamp
from drivers.errors import ConfigurationError, InputError, VolcalError
from drivers.foreign_errors import cause_of
from drivers.roles import TableImage

_WAIT_FOR_WRITER_S = 30.0
"""Longest wait for another writer: the service records requests during a run, and a slow disk must not end the run."""
_DISK_HINT = "check the disk under `state_directory`"


class Journal:
    """Journal, the database of all runs. It is a file in the state directory `directory`. It is created if it does not
    exist.

    One run writes at a time. The service adds single records during a run, and each of the two waits while the other
    writes. Pages and reports may read the database at the same time.

    Raises ConfigurationError if the database cannot be opened or created, or if its version is not the expected one.
    """

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE_NAME
        try:
            create_directory(directory)
            require_same_version(directory)
            self._connection = sqlite3.connect(self.path, isolation_level=None, timeout=_WAIT_FOR_WRITER_S)
            prepare(self._connection, self.path)
        except (OSError, sqlite3.Error) as error:
            raise ConfigurationError(
                f"the journal cannot be opened: {cause_of(error)}",
                file=str(self.path),
                hint="check `state_directory`, its owner and the free space",
            ) from error

    def close(self) -> None:
        self._connection.close()

    def start_run(self, run_id: str, kind: str, settings: Mapping[str, Any], software: str, clock: Clock) -> RunJournal:
        """Create a run in the state IDLE and return an object that writes its records. Raises Busy if there is already
        a run `run_id`, and JournalFailed if the run cannot be written.
        """
        try:
            cursor = self._connection.execute(
                "INSERT INTO runs (run_id, kind, started, state, software, settings) VALUES (?,?,?,?,?,?)",
                (run_id, kind, utc_timestamp(), RunState.IDLE.value, software, to_json(settings)),
            )
        except sqlite3.IntegrityError as error:
            raise Busy(f"run {run_id} exists already", file=str(self.path)) from error
        except sqlite3.Error as error:
            raise JournalFailed(
                f"the journal cannot be written: {cause_of(error)}", hint=_DISK_HINT, file=str(self.path)
            ) from error
        assert cursor.lastrowid is not None  # noqa: S101  an INSERT has one
        return RunJournal(self._connection, cursor.lastrowid, run_id, clock)

    def continue_run(self, run: int, run_id: str, clock: Clock) -> tuple[RunJournal, ReplayLog]:
        """Return a writer that continues an interrupted run, and a replay log of the records already written for the
        run.

        The resumed run first replays its procedure with the recorded results. If the replay produces an entry that is
        already in the log, the entry is removed from the log and is not written again. Raises InputError if the journal
        has no run with this number and this identity, and PlanRefused if the run has been compacted.
        """
        reader = JournalReader(self._connection, self.path)
        if reader.require_run(run_id).run != run:
            raise InputError(f"the journal has run {run_id} under another number", file=str(self.path))
        if run in reader.compacted_runs():
            raise PlanRefused(
                f"run {run_id} has been compacted and can no longer be resumed", hint="start a new run", run=run_id
            )
        recorded = read_replay_log(reader, run)
        return RunJournal(self._connection, run, run_id, clock, recorded), recorded

    def acknowledge(self, run_id: str, record: Mapping[str, Any]) -> None:
        """Record durably that a person has acknowledged the end of the run `run_id`; `record` may say who.

        The acknowledgement is stored as an event that is not part of the procedure, so the run can still be resumed.
        Raises JournalFailed if the event cannot be written.
        """
        self._insert_aside(run_id, "acknowledged", record, "the reset")

    def record_alarm(self, run_id: str, record: Mapping[str, Any]) -> None:
        """Record durably the alarm with which the run `run_id` ended, in the same way as an acknowledgement."""
        self._insert_aside(run_id, "alarm", record, "the alarm")

    def record_request(self, run_id: str, record: Mapping[str, Any]) -> None:
        """Record durably what a person asked of the run `run_id` while it was in progress, and who if that is known.
        The event is not part of the procedure, so the run can be resumed without it."""
        self._insert_aside(run_id, "request", record, "the request")

    def begin_idle_alarm(self, record: Mapping[str, Any]) -> None:
        """Record durably an alarm that arose between runs. Raises JournalFailed if it cannot be written."""
        self._execute(
            "INSERT INTO idle_alarms (at, record) VALUES (?, ?)", (utc_timestamp(), to_json(record)), "the alarm"
        )

    def end_idle_alarms(self, records: Sequence[Mapping[str, Any]]) -> None:
        """Record the end of the open alarms between runs that were recorded so."""
        for record in records:
            self._execute(
                "UPDATE idle_alarms SET until = ? WHERE until IS NULL AND record = ?",
                (utc_timestamp(), to_json(record)),
                "the end of the alarm",
            )

    def _insert_aside(self, run_id: str, kind: str, record: Mapping[str, Any], what: str) -> None:
        self._execute(
            "INSERT INTO events (run, at, kind, record, aside) SELECT run, ?, ?, ?, 1 FROM runs WHERE run_id = ?",
            (utc_timestamp(), kind, to_json(record), run_id),
            what,
        )

    def _execute(self, statement: str, values: Sequence[str], what: str) -> None:
        try:
            self._connection.execute(statement, values)
        except sqlite3.Error as error:
            raise JournalFailed(
                f"{what} cannot be recorded: {cause_of(error)}", hint=_DISK_HINT, file=str(self.path)
            ) from error


@dataclass
class _Count:
    """Counter with the last ordinal assigned, and whether the run has begun to measure or to write tables. Both are
    shared by all writers of one run."""

    ordinal: int
    worked: bool = False


class RunJournal:
    """Writer of the records of one run in the journal. The class implements `StepJournal`, the interface that the
    engine uses.
    """

    def __init__(
        self, connection: sqlite3.Connection, run: int, run_id: str, clock: Clock, recorded: ReplayLog | None = None
    ) -> None:
        self.run = run
        self.run_id = run_id
        self._connection = connection
        self._run = run
        self._clock = clock
        self._recorded = recorded or ReplayLog()
        self._count = _Count(self._recorded.ordinal)
        self._aside = 0

    def aside(self) -> Self:
        """Return a writer for rows of steps that are not part of the procedure of the run. A replay of the run skips
        these rows.

        For example, steps withdraw the probe and restore the table if a run ends early, and steps move the probe back
        if the run is resumed.
        """
        other = copy.copy(self)
        other._recorded, other._aside = ReplayLog(), 1
        return other

    @property
    def _ordinal(self) -> int:
        return self._count.ordinal

    def origin(self, record: Mapping[str, Any]) -> None:
        """Store `record`, which contains everything needed to rebuild the plan of the run."""
        self._execute("INSERT INTO origins (run, record) VALUES (?,?)", (self._run, to_json(record)))

    def begun(self) -> None:
        """Record that the preflight has ended. From then on, the run can be resumed."""
        self._execute(
            "UPDATE origins SET begun_s = ?, begun_at = ? WHERE run = ?",
            (self._clock.now(), utc_timestamp(), self._run),
        )

    def begin(self, step: Step) -> None:
        self._count.ordinal += 1
        if self._count.worked or type(step).__name__ not in WORKING_STEPS:
            self._insert_begun(step)
            return
        with self._transaction():
            self._close_unresumable()
            self._insert_begun(step)
        self._count.worked = True

    def _insert_begun(self, step: Step) -> None:
        self._execute(
            "INSERT INTO steps (run, ordinal, key, kind, detail, begun, aside) VALUES (?,?,?,?,?,?,?)",
            (
                self._run,
                self._ordinal,
                step.key,
                type(step).__name__,
                encode_step(step),
                self._clock.now(),
                self._aside,
            ),
        )

    def _close_unresumable(self) -> None:
        """Set the state of every other unfinished run to FAULTED. It can no longer be resumed once this run measures or
        writes tables."""
        self._execute(
            "UPDATE runs SET state = ?, reason = coalesce(reason || '; ', '') || ?, ended = ? "
            "WHERE ended IS NULL AND run <> ?",
            (RunState.FAULTED.value, f"interrupted, followed by run {self.run_id}", utc_timestamp(), self._run),
        )

    def finish(self, step: Step, result: object, *, begun: bool) -> None:
        if isinstance(step, (Enter, Conclude)):
            return  # the state and the entries of the conclusion are written by the step itself
        if begun:
            self._execute(
                "UPDATE steps SET finished = ?, result = ? WHERE run = ? AND ordinal = ?",
                (self._clock.now(), encode_result(result), self._run, self._ordinal),
            )
            return
        self._count.ordinal += 1
        with self._transaction():
            if isinstance(step, Record):
                self._write_record(step)
            else:
                self._write_reading(step, result)

    def fail(self, step: Step, error: BaseException) -> None:
        with self._transaction():
            self._execute(
                "UPDATE steps SET error = ? WHERE run = ? AND ordinal = ? AND key = ?",
                (str(error), self._run, self._ordinal, step.key),
            )
            self.fault(error, step.key)

    def fault(self, error: BaseException, step: str = "", *, before_return: bool = False) -> None:
        """Record an error that ends the run; its class decides whether the run can be resumed.

        `before_return` is True if the error has ended a resumption before the machine returned to where the run was
        interrupted; the run can then be resumed again.
        """
        told = {"before_return": True} if before_return else {}
        self._insert_event("fault", {"step": step, "error": str(error), "type": _class_of(error), **told})

    def event(self, kind: str, record: Mapping[str, Any]) -> None:
        self._insert_event(kind, record)

    def decision(self, kind: str, record: Mapping[str, Any]) -> None:
        text = to_json(record)
        if not self._recorded.consume("decisions", kind, text):
            values = (self._run, utc_timestamp(), kind, text, self._aside)
            self._execute("INSERT INTO decisions VALUES (?,?,?,?,?)", values)

    def estimate(self, record: str) -> None:
        """Store an estimate of the machine's errors. `record` is the JSON text of the estimate file."""
        recorded = self._recorded
        # The text is large: it is only taken apart if there is a recorded one to compare it with.
        if not (recorded.awaits("estimates") and recorded.consume("estimates", *comparable_estimate(record))):
            self._execute("INSERT INTO estimates VALUES (?,?,?)", (self._run, utc_timestamp(), record))

    def table(self, role: str, bank: int, image: TableImage | None) -> None:
        """Store a whole compensation table, `image`, that belongs to the controller's table memory number `bank`.
        `image` is None if this memory is empty.

        `role` is ``backup`` if the table was read from the controller before anything was written, ``staged`` if the
        run wrote it to the controller, and ``restored`` if the run made it active again.
        """
        if self._recorded.consume("tables", role, str(bank), "" if image is None else str(table_digest(image))):
            return
        values: tuple[object, ...] = (None,) * 6
        if image is not None:
            values = (
                table_digest(image),
                to_json(image.origin_mm),
                to_json(image.step_mm),
                image.resolution_mm,
                to_json(image.shape),
                image.counts.astype(">i4").tobytes(),
            )
        self._execute(
            "INSERT INTO tables VALUES (?,?,?,?,?,?,?,?,?,?,?)",
            (self._run, utc_timestamp(), role, bank, *values, self._aside),
        )

    def discard_since(self, key: str, reason: str) -> int:
        """Exclude the last step `key` of the procedure and everything after it from the procedure; a replay then ends
        before this step, and the run carries it out again.

        The excluded steps remain in the journal as steps aside. The records of the balls become events of the kind
        ``discarded``. Return the number of these balls.
        """
        with self._transaction():
            reader = JournalReader(self._connection)
            first = reader.ordinal_of(self._run, key)
            balls = [(ball.key, ball.record_text) for ball in reader.balls(self._run) if ball.ordinal >= first]
            where = (self._run, first)
            self._execute("UPDATE steps SET aside = 1 WHERE run = ? AND ordinal >= ?", where)
            self._execute("DELETE FROM balls WHERE run = ? AND ordinal >= ?", where)
            prefix = key.rpartition("/")[0] + "/"
            self._execute(
                "UPDATE events SET aside = 1 WHERE run = ? AND substr(json_extract(record, '$.step'), 1, ?) = ?",
                (self._run, len(prefix), prefix),
            )
            aside = self.aside()
            for ball, record in balls:
                aside._insert_event("discarded", {"ball": ball, "reason": reason, "record": json.loads(record)})
        return len(balls)

    def stored_table(self, crc32: int) -> TableImage | None:
        """Return the compensation table with the checksum `crc32` that this run stored; None if there is none."""
        try:
            return JournalReader(self._connection).image_with_digest(self._run, crc32)
        except sqlite3.Error as error:
            raise JournalFailed(f"the journal cannot be read: {cause_of(error)}", hint=_DISK_HINT) from error

    def state(self, state: RunState, reason: str = "", *, final: bool = False) -> None:
        with self._transaction():
            self._execute(
                "UPDATE runs SET state = ?, reason = ?, ended = ? WHERE run = ?",
                (state.value, reason or None, utc_timestamp() if final else None, self._run),
            )
            self._insert_event("state", {"state": state.value, "reason": reason})

    def _write_record(self, step: Record) -> None:
        if step.kind == "ball":
            if not self._recorded.consume("balls", step.key, to_json(step.payload)):
                self._insert_keyed("balls", step.key, step.payload)
        elif step.kind == "decision":
            self.decision(step.key, step.payload)
        else:
            record = {"step": step.key, **step.payload}
            if not self._recorded.consume("events", step.kind, to_json(record)):
                self._insert_event(step.kind, record)

    def _write_reading(self, step: Step, result: object) -> None:
        now = self._clock.now()
        self._execute(
            "INSERT INTO steps VALUES (?,?,?,?,?,?,?,?,NULL,?)",
            (
                self._run,
                self._ordinal,
                step.key,
                type(step).__name__,
                encode_step(step),
                now,
                now,
                encode_result(result),
                self._aside,
            ),
        )
        if isinstance(step, ReadTemperatures) and isinstance(result, Mapping):
            self._insert_keyed("temperatures", step.key, result)

    def _insert_keyed(self, table: str, key: str, record: Mapping[str, Any]) -> None:
        self._execute(
            f"INSERT INTO {table} VALUES (?,?,?,?)",  # noqa: S608  table is one of our own two names
            (self._run, self._ordinal, key, to_json(record)),
        )

    def _insert_event(self, kind: str, record: Mapping[str, Any]) -> None:
        values = (self._run, utc_timestamp(), kind, to_json(record), self._aside)
        self._execute("INSERT INTO events VALUES (?,?,?,?,?)", values)

    def _execute(self, statement: str, values: Sequence[object] = ()) -> sqlite3.Cursor:
        """Execute a statement. Raise JournalFailed if the database refuses it; nothing may move after that."""
        try:
            return self._connection.execute(statement, values)
        except sqlite3.Error as error:
            raise JournalFailed(f"the journal cannot be written: {cause_of(error)}", hint=_DISK_HINT) from error

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            if self._connection.in_transaction:  # SQLite rolls back on its own if the disk is full
                self._execute("ROLLBACK")
            raise
        self._execute("COMMIT")


def _class_of(error: BaseException) -> str:
    """Return the name of the class of the error tree to which the error belongs. A driver may have more special ones,
    which nobody who reads the journal knows."""
    tree = (VolcalError.__module__, RunError.__module__)
    return next((one.__name__ for one in type(error).__mro__ if one.__module__ in tree), type(error).__name__)
