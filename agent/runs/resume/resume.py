"""Resume the interrupted run: beside `agent.runs.session.carry_out`, and with the same results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path

from agent.execution.engine import Observer
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
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
    """Request to resume the unfinished run of `state_directory`; the rest as in `agent.runs.session.Request`.

    The run continues with the settings, the kind and the files that it began with, whatever they are now.
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
    """Resume the run. Raise InputError if there is nothing to resume, PlanDiverged if a file has changed, and as
    `carry_out` before the run is active again; afterwards every end is a `RunResult`."""
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
    """Return the unfinished run. Raise InputError, with the reason, if there is none or it cannot be resumed."""
    run = unfinished_run(state_directory)
    file = str(state_directory / FILE_NAME)
    if run is None:
        raise InputError("there is no run to resume: the last one ended regularly", file=file)
    if not run.resumable:
        raise InputError(f"run {run.run_id} cannot be resumed: {run.refusal}", file=file)
    return run


def origin_of(state_directory: Path, run: UnfinishedRun) -> Origin:
    """Return the origin of a run. Raise InputError as `read_origin`, or if the journal cannot be read."""
    with open_journal(state_directory) as reader:
        return read_origin(reader, run.run)
