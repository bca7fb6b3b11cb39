"""Resumption of an interrupted run.

`resume` is the counterpart of `agent.runs.session.carry_out`, which begins a new run; both return the same type of
result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from agent.errors import ArtefactMoved
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.rig import Rig
from agent.execution.run_state import RunStateTracker
from agent.execution.states import RunState
from agent.planning.job_preparation import prepare_job
from agent.runs.origin import Origin, read_origin
from agent.runs.reconcile import unproved_table
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.replay_engine import Replay, ReplayingEngine, require_crc
from agent.runs.resume.resumed_session import ResumedSession
from agent.runs.resume.return_to_position import ReturnToPosition
from agent.runs.resume.slow_moves import slow_until_contact
from agent.runs.resume.step_trace import StepTrace
from agent.runs.run_context import RunContext, RunHooks, run_actions
from agent.runs.run_start import record_asked
from agent.runs.session import RunResult, open_rig, run_resources
from agent.runs.step_progress import StepProgress
from agent.runs.unfinished_run import UnfinishedRun, unfinished_run
from drivers.clock import utc_timestamp
from drivers.errors import InputError
from drivers.roles import TableImage
from twin.units import S_PER_MIN


def resume(
    state_directory: Path, hooks: RunHooks | None = None, *, asked: Mapping[str, object] | None = None
) -> RunResult:
    """Resume the unfinished run of `state_directory` with the settings, the kind of run and the input files with which
    it was started.

    The run is planned again from its start conditions (axis positions, time and run number). The results of its
    recorded steps are taken from the journal, the machine returns to its position before the interruption, and the
    remaining steps are carried out. If the balls of the present position are no longer where they were, this position
    is measured again, at most once. `asked` contains the source of the request to resume; it is journaled.

    Raises InputError if there is no run to resume, PlanDiverged if an input file has changed since the start, and
    another error if the lock on the machine, the configuration or the journal prevents the resumption. Once the run is
    continued, its end, whether a success or an error, is returned as a `RunResult`.
    """
    hooks = hooks or RunHooks()
    first = _resume_once(state_directory, hooks, asked or {}, final=False)
    result = first or _resume_once(state_directory, hooks, asked or {}, final=True)
    assert result is not None  # noqa: S101  the last attempt has a result
    return result


def _resume_once(
    state_directory: Path, hooks: RunHooks, asked: Mapping[str, object], *, final: bool
) -> RunResult | None:
    """Resume the run and return its result.

    If `final` is False, return None if the run is to be resumed once more, because its present position was discarded
    and nobody has asked for the end of the run.
    """
    origin = resumable_origin(state_directory)
    settings, run_id = origin.settings, origin.run_id
    job = replace(prepare_job(settings, origin.base), latencies_from=origin.latencies_from)
    with run_resources(settings.state_directory, settings.clock, run_id, hooks) as resources:
        # Before the lock, another process may have used the machine.
        if _resumable_run(settings.state_directory).run_id != run_id:
            raise InputError("another run has begun meanwhile", run=run_id)
        run_clock = ResumedClock(resources.clock, origin.begun_s)
        clock = resources.interruptible(run_clock)
        rig = hooks.devices.assemble(settings, clock, origin.base)
        journal, recorded = resources.journal.continue_run(origin.start.run, run_id, clock)
        record_asked(journal, asked)
        tracker = RunStateTracker(journal, hooks.announce, recorded.states)
        steps = StepProgress(tracker, hooks.observe, rig)
        replay = Replay(recorded, run_clock, StepTrace())
        prefix = f"resume-{recorded.resumptions + 1}"
        actions = slow_until_contact(
            run_actions(rig, journal, tracker, resources.supervisor, hooks),
            settings.procedure.guarded_feed_mm_per_min / S_PER_MIN,
            f"{prefix}/",
        )
        engine = ReplayingEngine(actions, journal, steps.observe, replay, stored_tables(journal, rig))
        context = RunContext(rig, engine, journal, tracker, resources.supervisor, clock, hooks)
        session = ResumedSession(context, steps, job, origin, resources.began_s)
        with session.ended_by_errors():
            tracker.enter(RunState.RESUMING)
            with open_rig(context), session.compensation_compared():
                planned, ahead_s = session.plan(origin.start), continuation_time_s(origin)
                engine.set_return(
                    ReturnToPosition(
                        prefix, planned, session.progress, context, replay.trace, run_clock, origin.begun_s, ahead_s
                    )
                )
                session.carry_out(planned)
        moved = isinstance(session.progress.error, ArtefactMoved)
        if moved and not final and not resources.supervisor.stop_requested:
            return None
        return session.result()


def resumable_origin(state_directory: Path) -> Origin:
    """Return the origin of the unfinished run: its settings, its kind of run and its start conditions (axis positions,
    time and run number).

    The settings name `state_directory` even if it was moved since the run began.

    Raises InputError, with the reason, if there is no unfinished run, if the run cannot be resumed, or if the journal
    cannot be read. Raises PlanDiverged if an input file has changed since the run began.
    """
    run = _resumable_run(state_directory)
    with open_journal(state_directory) as reader:
        origin = read_origin(reader, run.run)
    origin.require_unchanged()
    return replace(origin, settings=origin.settings.model_copy(update={"state_directory": state_directory.resolve()}))


def _resumable_run(state_directory: Path) -> UnfinishedRun:
    run = unfinished_run(state_directory)
    file = str(state_directory / FILE_NAME)
    if run is None:
        unproved = unproved_table(state_directory)
        hint = "" if unproved is None else f"{unproved.situation}; {unproved.way_out}"
        raise InputError("there is no run to resume: the last one has ended", hint=hint, file=file)
    if not run.resumable:
        raise InputError(f"run {run.run_id} cannot be resumed: {run.refusal}", file=file)
    return run


def stored_tables(journal: RunJournal, rig: Rig) -> Callable[[int, int], TableImage]:
    """Return a function that returns a compensation table from the journal or else from the controller. The table is
    identified by its bank and its CRC-32.

    The returned function raises PlanDiverged if the bank no longer contains the table with this CRC-32.
    """

    def stored(bank: int, crc32: int) -> TableImage:
        return journal.stored_table(crc32) or require_crc(rig.store.read_table(bank), bank, crc32)

    return stored


def continuation_time_s(origin: Origin) -> float:
    """Return the machine time in s at which an interrupted run continues.

    If machine time is wall time, the duration of the interruption is counted and therefore uses up part of the machine
    time available to the run.
    """
    if origin.settings.clock.kind != "real":
        return origin.begun_s
    passed = datetime.fromisoformat(utc_timestamp()) - datetime.fromisoformat(origin.begun_at)
    return origin.begun_s + passed.total_seconds()
