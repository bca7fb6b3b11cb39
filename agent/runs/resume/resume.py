"""Go on with the run that broke off: beside `agent.runs.session.carry_out`, and with the same answers."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field
from pathlib import Path

from agent.execution.engine import Observer
from agent.execution.journal import FILE_NAME
from agent.execution.rig import Rig
from agent.execution.run_lock import run_lock
from agent.execution.run_state import Listener
from agent.execution.supervisor import Supervisor
from agent.planning.job import prepare_job
from agent.reports.renderer import Reports, rebuilt_here
from agent.runs.kinds.kind import Ready
from agent.runs.origin import Origin, read_origin
from agent.runs.resume.resume_start import Resumption
from agent.runs.session import Request, RunResult, carry_out
from agent.runs.unfinished_run import UnfinishedRun, unfinished_run
from agent.settings.schema import Settings
from drivers.clock import Clock
from drivers.errors import InputError


@dataclass(frozen=True)
class ResumeRequest:
    """Who wants the unfinished run of `state_directory` gone on with; the rest as in `agent.runs.session.Request`.

    The run goes on with the settings, the kind and the files that it began with, whatever they are now.
    """

    state_directory: Path
    listener: Listener
    interrupts: Callable[[Supervisor], None]
    clock: Clock | None = None
    rig: Callable[[Settings, Clock, Path], Rig] | None = None
    files: bool = True
    asked: Mapping[str, object] = field(default_factory=dict)
    lock: Callable[[Path, str], AbstractContextManager[None]] = run_lock
    observer: Observer | None = None
    passed: Callable[[Ready], None] = lambda _: None
    reports: Reports = rebuilt_here


def resume(request: ResumeRequest) -> RunResult:
    """Raises InputError where there is nothing to go on with, PlanDiverged where a file has changed, and as `carry_out`
    before the run lives again; afterwards every end is an `RunResult`."""
    run = require_resumable(request.state_directory)
    origin = origin_of(request.state_directory, run)
    origin.require_unchanged()
    return carry_out(
        Request(
            job=prepare_job(origin.settings, origin.base),
            base=origin.base,
            listener=request.listener,
            interrupts=request.interrupts,
            kind=origin.kind,
            clock=request.clock,
            rig=request.rig,
            files=request.files,
            run_id=run.run_id,
            asked=request.asked,
            lock=request.lock,
            observer=request.observer,
            passed=request.passed,
            beginning=Resumption(origin),
            reports=request.reports,
        )
    )


def require_resumable(state_directory: Path) -> UnfinishedRun:
    """The unfinished run. InputError where there is none, or why it cannot be gone on with."""
    run = unfinished_run(state_directory)
    file = str(state_directory / FILE_NAME)
    if run is None:
        raise InputError("there is no run to go on with: the last one came to an end of its own", file=file)
    if not run.resumable:
        raise InputError(f"run {run.run_id} cannot be gone on with: {run.refusal}", file=file)
    return run


def origin_of(state_directory: Path, run: UnfinishedRun) -> Origin:
    path = state_directory / FILE_NAME
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            return read_origin(connection, run.run)
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error
