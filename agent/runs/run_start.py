"""How a run enters its life: begun anew, or gone on with (`agent.runs.resume.resume_start`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

from agent.errors import PlanRefused
from agent.execution.engine import Engine, Observer
from agent.execution.journal import Journal, RunJournal
from agent.execution.rig import Rig
from agent.execution.run_state import Listener, RunStateTracker
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.results.journal_entries import INPUTS, inputs_of
from agent.runs.guarded_run import GuardedRun
from agent.runs.kinds.kind import Kind
from agent.runs.origin import origin_record
from agent.runs.reconcile import has_compensation_record, reconcile
from agent.runs.reconcile_result import CompensationState
from agent.runs.start_conditions import Outset
from drivers.clock import Clock, utc_timestamp


@dataclass(frozen=True)
class Wanted:
    """What is to be carried out, whichever way it begins."""

    run_id: str
    job: Job
    kind: Kind
    base: Path


class Beginning(Protocol):
    @property
    def state(self) -> RunState:
        """The first state that the run enters."""
        ...

    def clock(self, outer: Clock) -> Clock:
        """Machine seconds of the run."""
        ...

    def written(
        self, journal: Journal, wanted: Wanted, clock: Clock, listener: Listener
    ) -> tuple[RunJournal, RunStateTracker]:
        """The run in the journal, and its state."""
        ...

    def outset(self, rig: Rig, journal: RunJournal, wanted: Wanted) -> Outset:
        """What the run begins from; the rig is open."""
        ...

    def engine(self, rig: Rig, journal: RunJournal, observe: Observer) -> Engine: ...

    def begun(self, run: GuardedRun, journal: RunJournal, tracker: RunStateTracker) -> None:
        """The preflight is over; nothing of the run has been done yet."""
        ...

    def broken_off(self, rig: Rig, complain: Callable[[str], None]) -> None:
        """The run has ended by an error while the rig was open."""
        ...


class Fresh:
    """A run that begins now."""

    state = RunState.PREFLIGHT

    def __init__(self) -> None:
        self._journal: Journal | None = None

    def clock(self, outer: Clock) -> Clock:
        return outer

    def written(
        self, journal: Journal, wanted: Wanted, clock: Clock, listener: Listener
    ) -> tuple[RunJournal, RunStateTracker]:
        self._journal = journal
        document, inputs = wanted.job.settings.model_dump(mode="json"), inputs_of(wanted.job)
        run_journal = journal.start_run(wanted.run_id, wanted.kind.name, document, version("volcal"), clock)
        run_journal.decision(INPUTS, inputs)
        return run_journal, RunStateTracker(run_journal, listener)

    def outset(self, rig: Rig, journal: RunJournal, wanted: Wanted) -> Outset:
        x, y, z = rig.machine.position().tolist()
        self._require_nothing_unproved(rig, wanted)
        outset = Outset(journal.run, utc_timestamp(), (x, y, z))
        journal.origin(origin_record(wanted.job.settings, wanted.kind, wanted.base, outset))
        return outset

    def engine(self, rig: Rig, journal: RunJournal, observe: Observer) -> Engine:
        return Engine(rig.actions(journal.run), journal, observe)

    def begun(self, run: GuardedRun, journal: RunJournal, tracker: RunStateTracker) -> None:
        journal.begun()
        assert self._journal is not None  # noqa: S101  written first
        self._journal.close_dead(journal.run, f"broke off, followed by run {journal.run_id}")

    def _require_nothing_unproved(self, rig: Rig, wanted: Wanted) -> None:
        """PlanRefused where a former run has left a table that must be proved or taken back first: another run would
        take it for what the machine is meant to have."""
        directory = wanted.job.settings.state_directory
        if not has_compensation_record(directory):
            return
        left = reconcile(rig, directory, restore=False)
        if left.state in (CompensationState.UNPROVED, CompensationState.WAITING):
            raise PlanRefused(
                f"the last run has left the compensation unfinished: {left.text}",
                hint="`volcal resume` goes on with it, `volcal resume --give-up` makes the former table act again",
            )

    def broken_off(self, rig: Rig, complain: Callable[[str], None]) -> None:
        """The run's own way out has done what there was to do."""
