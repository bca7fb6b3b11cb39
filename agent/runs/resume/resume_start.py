"""Going on with a run that broke off: the same beginning again, its steps answered from the journal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from agent.execution.engine import Engine, Observer
from agent.execution.journal import Journal, RunJournal
from agent.execution.rig import Rig
from agent.execution.run_state import Listener, RunStateTracker
from agent.execution.states import RunState
from agent.runs.guarded_run import GuardedRun
from agent.runs.origin import Origin
from agent.runs.reconcile import reconcile
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.replay_engine import Replay, ReplayingEngine, require_crc
from agent.runs.resume.return_to_position import Returning
from agent.runs.resume.step_trace import Trace
from agent.runs.run_start import Wanted
from agent.runs.start_conditions import Outset
from drivers.clock import Clock, utc_timestamp
from drivers.errors import VolcalError
from drivers.roles import TableImage


@dataclass
class _Parts:
    """What is put together as the run comes to life."""

    clock: ResumedClock
    tracker: RunStateTracker
    replay: Replay
    prefix: str


class Resumption:
    """`agent.runs.run_start.Beginning` of a run that is gone on with."""

    state = RunState.RESUMING

    def __init__(self, origin: Origin) -> None:
        self._origin = origin
        self._clock: ResumedClock | None = None
        self._parts: _Parts | None = None
        self._engine: ReplayingEngine | None = None
        self._rig: Rig | None = None

    def clock(self, outer: Clock) -> Clock:
        self._clock = ResumedClock(outer, self._origin.begun_s)
        return self._clock

    def written(
        self, journal: Journal, wanted: Wanted, clock: Clock, listener: Listener
    ) -> tuple[RunJournal, RunStateTracker]:
        assert self._clock is not None  # noqa: S101  asked for first
        run_journal, recorded = journal.continue_run(self._origin.outset.run, wanted.run_id, clock)
        tracker = RunStateTracker(run_journal, listener, recorded.states)
        replay = Replay(recorded, self._clock, Trace())
        self._parts = _Parts(self._clock, tracker, replay, f"resume-{recorded.resumptions + 1}")
        return run_journal, tracker

    def outset(self, rig: Rig, journal: RunJournal, wanted: Wanted) -> Outset:
        return self._origin.outset

    def engine(self, rig: Rig, journal: RunJournal, observe: Observer) -> Engine:
        def stored(bank: int, crc32: int) -> TableImage:
            return journal.stored_table(crc32) or require_crc(rig.store.read_table(bank), bank, crc32)

        self._rig = rig
        actions = rig.actions(journal.run)
        self._engine = ReplayingEngine(actions, journal, observe, self._known.replay, stored)
        return self._engine

    def begun(self, run: GuardedRun, journal: RunJournal, tracker: RunStateTracker) -> None:
        assert self._engine is not None  # noqa: S101  built just before
        assert self._rig is not None  # noqa: S101  the same
        known = self._known
        aside = self._engine.aside()
        returning = Returning(
            known.prefix,
            self._rig,
            known.replay.trace,
            aside,
            lambda: run.rules,
            run.too_late,
            tracker,
            known.clock,
            self._time_s(),
            run.activation,
        )
        self._engine.returns_by(returning)

    def broken_off(self, rig: Rig, complain: Callable[[str], None]) -> None:
        """The way out knows only what the replay has come to; a new table may act that it never came to."""
        try:
            found = reconcile(rig, self._origin.settings.state_directory, of_run=self._origin.outset.run)
        except VolcalError as error:
            complain(f"could not see what the controller's compensation is: {error}")
            return
        complain(f"compensation: {found.text}")

    def _time_s(self) -> float:
        """By the calendar, where machine time is that of the wall: the time in between has passed for a slot too."""
        origin = self._origin
        if origin.settings.clock.kind != "real":
            return origin.begun_s
        passed = datetime.fromisoformat(utc_timestamp()) - datetime.fromisoformat(origin.begun_at)
        return origin.begun_s + passed.total_seconds()

    @property
    def _known(self) -> _Parts:
        assert self._parts is not None  # noqa: S101  written before anything else is asked
        return self._parts
