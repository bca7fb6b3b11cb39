"""Run states under any order of requests: the state entered, journaled and announced is always the same."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.run_state import Announcement, RunStateTracker
from agent.execution.states import FINAL, RunState
from drivers.clock import VirtualClock

# Written by hand from the designed sequence of states, not from the table under test.
CHAIN = [
    RunState.IDLE,
    RunState.PREFLIGHT,
    RunState.MEASURING,
    RunState.IDENTIFYING,
    RunState.STAGING,
    RunState.ACTIVATING,
    RunState.VERIFYING,
    RunState.COMPLETE,
]


class RunStates(RuleBasedStateMachine):
    """State machine test: any state is requested at any time; the journal is read through its own connection."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.journal = Journal(Path(self.folder.name))
        run = self.journal.start_run("run", "calibrate", {}, "0", VirtualClock())
        self.heard: list[Announcement] = []
        self.tracker = RunStateTracker(run, self.heard.append)
        self.entered = [RunState.IDLE]

    @rule(state=st.sampled_from(RunState), reason=st.text(max_size=20))
    def ask(self, state: RunState, reason: str) -> None:
        before = self.tracker.state
        try:
            self.tracker.enter(state, reason)
        except ValueError:
            assert self.tracker.state is before
        else:
            self.entered.append(state)

    @precondition(lambda self: self.tracker.state in CHAIN[:-1])
    @rule()
    def go_on(self) -> None:
        """Check that the next state is allowed from every state of the sequence."""
        following = CHAIN[CHAIN.index(self.tracker.state) + 1]
        self.tracker.enter(following)
        self.entered.append(following)

    @precondition(lambda self: self.tracker.state not in FINAL)
    @rule()
    def break_off(self) -> None:
        """Check that a run can be aborted from any state and then ends."""
        if self.tracker.state is not RunState.ABORTING:
            self.tracker.enter(RunState.ABORTING, "button")
            self.entered.append(RunState.ABORTING)
        self.tracker.enter(RunState.ABORTED, "button")
        self.entered.append(RunState.ABORTED)

    @invariant()
    def the_journal_knows_the_state(self) -> None:
        with open_journal(Path(self.folder.name)) as reader:
            (run,) = reader.runs()
        assert run.state == self.tracker.state.value
        assert (run.ended is not None) == (self.tracker.state in FINAL)

    @invariant()
    def everybody_heard_of_everything_once(self) -> None:
        assert [a.data["state"] for a in self.heard] == [s.value for s in self.entered[1:]]

    @invariant()
    def nothing_follows_an_end(self) -> None:
        assert not any(state in FINAL for state in self.entered[:-1])

    @invariant()
    def no_table_is_activated_without_measurement_and_identification(self) -> None:
        if RunState.ACTIVATING in self.entered:
            done = self.entered[: self.entered.index(RunState.ACTIVATING)]
            assert {RunState.MEASURING, RunState.IDENTIFYING, RunState.STAGING} <= set(done)
            assert {RunState.PREFLIGHT, RunState.RESUMING} & set(done)

    def teardown(self) -> None:
        self.journal.close()
        self.folder.cleanup()


TestRunStates = RunStates.TestCase
TestRunStates.settings = settings(max_examples=25, stateful_step_count=20, deadline=None)


def test_a_jump_over_the_proof_is_refused() -> None:
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal(Path(folder))
        tracker = RunStateTracker(journal.start_run("r", "calibrate", {}, "0", VirtualClock()), lambda _: None)
        for state in CHAIN[1:6]:
            tracker.enter(state)
        with pytest.raises(ValueError, match="no change from activating to complete"):
            tracker.enter(RunState.COMPLETE)
        journal.close()
