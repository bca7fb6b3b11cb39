"""Decoder of journals: everything that pages, reports, history and resumption read of one."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from agent.execution.journal_copy import copy_journal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.replay_log import read_replay_log
from agent.execution.run_record import read_record, read_steps, run_heads, run_ids
from agent.history.run_row import run_rows
from agent.runs.origin import read_origin
from agent.runs.reconcile import has_compensation_record, unproved_table
from agent.runs.reference_state import full_calibration_need, read_reference
from agent.runs.unfinished_run import unfinished_run
from agent.service.state.archive import Archive
from agent.service.state.journal_state import JournalState
from campaigns.fuzz.trial import Decoder
from campaigns.resume.case import prepare_case
from drivers.errors import VolcalError
from twin.errors import TwinError


def run_for_journal() -> tuple[bytes, str]:
    """Carry out a short simulated run, and return its journal as one file and its estimate file."""
    with TemporaryDirectory(prefix="volcal-fuzz-") as folder:
        settings, machine = prepare_case(Path(folder))
        state = Path(folder) / "state"
        machine.run(settings.model_copy(update={"state_directory": state}))
        path = state / FILE_NAME
        with closing(sqlite3.connect(path)) as connection:
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute("VACUUM")
        with open_journal(state) as reader:
            estimate = reader.last_estimate(1)
        return path.read_bytes(), estimate or ""


def journal_decoder(journal: bytes) -> Decoder:
    # One input is read in a dozen ways, and the good one takes half a second.
    return Decoder("journal (SQLite)", [journal], read_everything, cpu_bound_s=12.0)


def read_everything(data: bytes) -> None:
    """Read a journal in every way. Each way may refuse it; the first refusal is raised after all ways were tried."""
    with TemporaryDirectory(prefix="volcal-fuzz-") as folder:
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
