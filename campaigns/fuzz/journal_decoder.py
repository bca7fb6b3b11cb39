"""Decoders of journals and of the history: everything that pages, reports and resumption read of one."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import URL

from agent.execution.journal_copy import copy_journal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.replay_log import read_replay_log
from agent.execution.run_record import read_record, read_steps, run_heads, run_ids
from agent.history.cached_trends import CachedTrends
from agent.history.database_url import DatabaseAddress
from agent.history.export import as_csv, as_json
from agent.history.metrics import metrics_text
from agent.history.overview import alarms_of
from agent.history.retention import compact
from agent.history.run_row import machine_name, run_rows
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.runs.origin import read_origin
from agent.runs.reconcile import has_compensation_record, unproved_table
from agent.runs.reference_state import full_calibration_need, read_reference
from agent.runs.unfinished_run import unfinished_run
from agent.service.state.archive import Archive
from agent.service.state.journal_state import JournalState
from agent.settings.history import HistorySettings
from benchmarks.places import memory_directory
from campaigns.fuzz.estimate_decoder import short_estimate
from campaigns.fuzz.trial import Decoder
from campaigns.resume.case import prepare_case
from drivers.errors import VolcalError
from twin.errors import TwinError
from twin.formats.compressed_text import compress_text, expand_text

LEFT_OUT = (
    """DELETE FROM steps WHERE ordinal IN (SELECT ordinal FROM (
    SELECT ordinal, row_number() OVER (PARTITION BY kind ORDER BY ordinal) AS place FROM steps) WHERE place > 20)""",
    "DELETE FROM balls WHERE ordinal NOT IN (SELECT ordinal FROM balls ORDER BY ordinal LIMIT 20)",
    "DELETE FROM temperatures WHERE ordinal NOT IN (SELECT ordinal FROM temperatures ORDER BY ordinal LIMIT 20)",
)
"""Statements that leave the first 20 steps of each kind, 20 balls and 20 temperatures of the only run of a journal."""


class RunFiles(NamedTuple):
    """Files of a run of which not all rows are kept (`_shorten`): its journal, the journal with the run compacted, and
    the history as SQLite files, and the text of its estimate file."""

    journal: bytes
    compacted: bytes
    history: bytes
    estimate: str


def run_for_journal() -> RunFiles:
    """Carry out a short simulated run, and return its files."""
    with memory_directory("fuzz") as folder:
        settings, machine = prepare_case(Path(folder), order=2)
        state = Path(folder) / "state"
        machine.run(settings.model_copy(update={"state_directory": state}))
        _shorten(state / FILE_NAME)
        whole = _one_file(state)
        with open_journal(state) as reader:
            estimate, (row,) = reader.last_estimate(1), reader.runs()
        history = _history(state)
        compact(state, row, write=True)
        return RunFiles(whole, _one_file(state), history, estimate or "")


def _shorten(journal: Path) -> None:
    """Leave only some of the rows (`LEFT_OUT`) and a short estimate: the others have the same forms, and the time in
    which an input is read grows with their number."""
    with closing(sqlite3.connect(journal)) as connection:
        for statement in LEFT_OUT:
            connection.execute(statement)
        for number, text in connection.execute("SELECT rowid, record FROM estimates").fetchall():
            connection.execute("UPDATE estimates SET record = ? WHERE rowid = ?", (short_estimate(text), number))
        connection.commit()


def _one_file(state: Path) -> bytes:
    """Return the journal as one file, without a write-ahead log and free pages."""
    path = state / FILE_NAME
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("VACUUM")
    return path.read_bytes()


def _history(state: Path) -> bytes:
    """Return the history of the runs in the state directory `state`."""
    path = state / "history.sqlite"
    (head,) = run_heads(state)
    with closing(HistoryStore(_address(path, machine_name(head.settings)))) as store:
        sync(state, store)
    return path.read_bytes()


def _address(path: Path, machine: str) -> DatabaseAddress:
    return DatabaseAddress(URL.create("sqlite", database=str(path)), machine, timeout_s=1.0)


def journal_decoder(files: RunFiles) -> Decoder:
    # One input is read in a dozen ways, and the good one takes half a second.
    seeds = [files.journal, files.compacted]
    return Decoder("journal (SQLite)", seeds, read_everything, cpu_bound_s=12.0, share=0.1)


def compacted_decoder(files: RunFiles) -> Decoder:
    """Return the decoder of the packed rows of a run, whose journal is otherwise good."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(files.compacted)
        [content] = connection.execute("SELECT content FROM compacted_runs").fetchone()

    def read(data: bytes) -> None:
        with closing(sqlite3.connect(":memory:")) as journal:
            journal.deserialize(files.compacted)
            journal.execute("UPDATE compacted_runs SET content = ?", (compress_text(data),))
            journal.commit()
            read_everything(journal.serialize())

    return Decoder("compacted run (JSON)", [expand_text(content)], read, cpu_bound_s=12.0, share=0.1)


def history_decoder(history: bytes) -> Decoder:
    with memory_directory("fuzz") as folder:
        path = Path(folder) / "history.sqlite"
        path.write_bytes(history)
        with closing(HistoryStore(_address(path, ""))) as store:
            (machine,) = store.machines()
    return Decoder("history (SQLite)", [history], lambda data: _read_history(data, machine), cpu_bound_s=5.0, share=0.3)


def _read_history(data: bytes, machine: str) -> object:
    """Read a history as the page, the metrics and the commands do."""
    with memory_directory("fuzz") as folder:
        path = Path(folder) / "history.sqlite"
        path.write_bytes(data)
        with closing(HistoryStore(_address(path, machine))) as store:
            store.digests(machine), store.ends(machine), store.machines()
            runs = store.runs(machine)
            found = CachedTrends().refreshed(store, HistorySettings())
        alarms = alarms_of(found.trends, found.by_date.ahead)
        return metrics_text(machine, found.by_date, found.trends, {}), as_csv(runs), as_json(runs), alarms


def read_everything(data: bytes) -> None:
    """Read a journal in every way. Each way may refuse it; the first refusal is raised after all ways were tried."""
    with memory_directory("fuzz") as folder:
        state = Path(folder)
        (state / FILE_NAME).write_bytes(data)
        refusals: list[Exception] = []
        for read in _ways(state):
            try:
                read()
            except (VolcalError, TwinError) as error:
                refusals.append(error)
        if refusals:
            raise refusals[0]


def _ways(state: Path) -> list[Callable[[], object]]:
    archive, service = Archive(state, lambda _: state), JournalState(state)
    return [
        lambda: unfinished_run(state),
        lambda: unproved_table(state),
        lambda: has_compensation_record(state),
        lambda: read_reference(state),
        lambda: full_calibration_need(state),
        service.unacknowledged_end,
        lambda: archive.runs(50),
        lambda: archive.tables(50),
        lambda: _read_runs(archive, state),
        lambda: [head.settings for head in run_heads(state)],
        lambda: _replay(state),
        lambda: copy_journal(state, _made(state / "copy"), lambda settings: settings),
    ]


def _read_runs(archive: Archive, state: Path) -> None:
    for run_id in run_ids(state):
        _read_run(archive, state, run_id)


def _read_run(archive: Archive, state: Path, run_id: str) -> None:
    archive.run(run_id)
    archive.balls(run_id)
    archive.temperatures(run_id)
    archive.events(run_id, 1000)
    archive.estimate(run_id)
    record = read_record(state, run_id)
    for row in (*record.decisions, *record.events):
        _ = row.record
    for step in read_steps(state, run_id).steps:
        _ = step.detail, step.result
    run_rows(record)


def _replay(state: Path) -> None:
    with open_journal(state) as reader:
        for row in reader.runs():
            read_replay_log(reader, row.run)
            read_origin(reader, row.run)
            for table in reader.tables(row.run):
                reader.image(table)


def _made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder
