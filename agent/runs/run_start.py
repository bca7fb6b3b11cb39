"""Start of a new run: its entry in the journal, and the conditions from which it starts."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from agent.errors import PlanRefused
from agent.execution.journal import Journal, RunJournal
from agent.execution.rig import Rig
from agent.planning.job import Job
from agent.results.decision_kinds import INPUTS
from agent.results.journal_entries import inputs_of
from agent.runs.planned_run import Kind, StartConditions
from agent.runs.reconcile import has_compensation_record, reconcile
from agent.runs.reconcile_result import CompensationState
from drivers.clock import Clock, utc_timestamp


def enter_in_journal(
    journal: Journal, run_id: str, job: Job, kind: Kind, clock: Clock, asked: Mapping[str, object]
) -> RunJournal:
    """Enter a new run with its settings, its input files and who `asked` for it. Raises Busy if `run_id` is taken."""
    settings, inputs = job.settings.model_dump(mode="json"), inputs_of(job)
    run_journal = journal.start_run(run_id, kind.name, settings, version("volcal"), clock)
    run_journal.decision(INPUTS, inputs)
    record_asked(run_journal, asked)
    return run_journal


def record_asked(journal: RunJournal, asked: Mapping[str, object]) -> None:
    """Journal who asked for a run, and for what; nothing if that is not stated."""
    if asked:
        journal.event("asked", asked)


def read_start_conditions(rig: Rig, journal: RunJournal, state_directory: Path) -> StartConditions:
    """Return the conditions here and now; `rig` is open. PlanRefused if the compensation is unfinished."""
    x, y, z = rig.machine.position().tolist()
    _require_finished_compensation(rig, state_directory)
    return StartConditions(journal.run, utc_timestamp(), (x, y, z))


def _require_finished_compensation(rig: Rig, state_directory: Path) -> None:
    """Raise PlanRefused if a former run left a table that must be proved or reverted first: another run would treat it
    as the intended compensation of the machine."""
    if not has_compensation_record(state_directory):
        return
    left = reconcile(rig, state_directory, restore=False)
    if left.state in (CompensationState.UNPROVED, CompensationState.WAITING):
        raise PlanRefused(
            f"the last run has left the compensation unfinished: {left.text}",
            hint="`volcal resume` resumes that run, `volcal resume --give-up` makes the former table active again",
        )
