"""Start of a new run. A run starts with its entry in the journal and the reading of its start conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import version
from itertools import islice
from pathlib import Path

from agent.errors import PlanRefused
from agent.execution.journal import Journal, RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.planning.job import Job
from agent.results.decision_kinds import INPUTS
from agent.results.journal_entries import inputs_of
from agent.runs.planned_run import Kind, StartConditions
from agent.runs.reconcile import has_compensation_record, reconcile
from agent.runs.reconcile_result import CompensationState
from agent.runs.step_progress import FormerPreflight
from drivers.clock import Clock, utc_timestamp
from drivers.errors import InputError

_LATEST_RUNS = 20
_FIRST_NOTES = 10


def enter_in_journal(
    journal: Journal, run_id: str, job: Job, kind: Kind, clock: Clock, asked: Mapping[str, object]
) -> RunJournal:
    """Create a run in the journal, and store its settings, its input files and its request there.

    `asked` contains the source and content of the request. Raises Busy if the journal already has a run `run_id`.
    """
    settings, inputs = job.settings.model_dump(mode="json"), inputs_of(job)
    run_journal = journal.start_run(run_id, kind.name, settings, version("volcal"), clock)
    run_journal.decision(INPUTS, inputs)
    record_asked(run_journal, asked)
    return run_journal


def record_asked(journal: RunJournal, asked: Mapping[str, object]) -> None:
    """Journal the source and content of the request for a run; do nothing if `asked` is empty."""
    if asked:
        journal.event("asked", asked)


def read_start_conditions(
    rig: Rig, journal: RunJournal, state_directory: Path, note: Callable[[str], None]
) -> StartConditions:
    """Return the present axis positions, the time and the run number as start conditions. `rig`, the devices of the
    machine, must be open.

    `note` receives the comparison of the compensation with the earlier runs if somebody has changed it since. Raise
    PlanRefused if an earlier run has left a compensation table that is not yet confirmed by measurements or not yet
    active.
    """
    x, y, z = rig.machine.position().tolist()
    _require_finished_compensation(rig, state_directory, note)
    return StartConditions(
        journal.run,
        utc_timestamp(),
        (x, y, z),
        rig.store.store_limits(),
        no_homing=rig.why_no_homing(),
        homing_directions=rig.homing_directions(),
    )


def last_preflight(state_directory: Path, kind: str) -> FormerPreflight | None:
    """Return the preflight of the last run of the kind `kind`; None if none of the latest runs is of this kind or says
    it, or if what it says is damaged: the progress that is shown must not refuse a run."""
    with suppress(InputError), open_journal(state_directory) as reader:
        latest = [run for run in islice(reader.latest_begun_runs(), _LATEST_RUNS) if run.kind == kind]
        for run in latest:
            for note in reader.events(run.run, {"note"}, limit=_FIRST_NOTES):
                if FormerPreflight.STEPS in note.record:
                    return FormerPreflight.of(note.record)
    return None


def _require_finished_compensation(rig: Rig, state_directory: Path, note: Callable[[str], None]) -> None:
    """Raise PlanRefused if an earlier run left a table that must first be proved or replaced by the former one.

    A new run would take it for the intended compensation of the machine.
    """
    if not has_compensation_record(state_directory):
        return
    left = reconcile(rig, state_directory, restore=False)
    if left.blocks_runs:
        raise PlanRefused(
            f"the last run has left the compensation unfinished: {left.text}",
            hint="no new run starts before that is settled",
        )
    if left.state is CompensationState.CHANGED:
        note(f"compensation: {left.text}")
