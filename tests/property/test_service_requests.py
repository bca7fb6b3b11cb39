"""Random requests from several endpoints: one run at a time, faults persist, aborts are always accepted."""

from __future__ import annotations

import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit" / "agent"))
from service_house import PATIENCE_S, house

from agent.errors import Aborted, Busy, PlanRefused
from agent.execution.states import FINAL, FORWARD, PACKML, RunState, may_follow
from agent.runs.run_kinds import KINDS
from agent.runs.run_request import SOURCES, RunRequest
from agent.service.allowed_requests import ALLOWED, AT_REST, STICKY
from drivers.errors import LinkLost, PermissionMissing, UserError

S = RunState
ENDS = [S.COMPLETE, S.REFUSED, S.ABORTED, S.FAULTED]
ERRORS = {
    S.COMPLETE: None,
    S.REFUSED: PlanRefused("it would hit"),
    S.ABORTED: Aborted("aborted"),
    S.FAULTED: LinkLost("the cable is out", hint="plug it in"),
}


class Requests(RuleBasedStateMachine):
    """Model of the service: a state, whether a run is active, and the first cause of a persistent fault."""

    @initialize()
    def build(self) -> None:
        self.stack = ExitStack()
        directory = self.stack.enter_context(tempfile.TemporaryDirectory())
        self.house = self.stack.enter_context(house(Path(directory)))
        self.owner = self.house.owner
        self.state = S.IDLE
        self.run_id: str | None = None
        self.cause: str | None = None
        self.aborted = False
        self.events = self.stack.enter_context(self.owner.subscribe())
        self.last_number = 0

    def teardown(self) -> None:
        if hasattr(self, "stack"):
            if self.running:
                self.house.puppet.end(S.COMPLETE)
                assert self.owner.wait(PATIENCE_S)
            self.stack.close()

    @property
    def running(self) -> bool:
        return self.state not in AT_REST

    @rule(kind=st.sampled_from(KINDS), source=st.sampled_from(SOURCES), consent=st.booleans())
    def start(self, kind, source, consent) -> None:
        request = RunRequest(kind=kind, source=source, consent=consent)
        if self.running:
            with pytest.raises(Busy, match=self.run_id):
                self.owner.start(request)
        elif self.state in STICKY:
            with pytest.raises(PermissionMissing, match="reset"):
                self.owner.start(request)
        else:
            self.run_id = self.owner.start(request)
            self.house.puppet.begun()
            self.state, self.aborted, self.cause = S.PREFLIGHT, False, None

    @precondition(lambda self: self.running)
    @rule(data=st.data())
    def the_run_goes_on(self, data) -> None:
        onward = sorted((s for s in FORWARD[self.state] if s not in AT_REST), key=lambda s: s.value)
        if onward:
            self.state = data.draw(st.sampled_from(onward))
            self.house.puppet.enter(self.state)

    @precondition(lambda self: self.running)
    @rule(end=st.sampled_from(ENDS))
    def the_run_ends(self, end) -> None:
        self.house.puppet.end(end, ERRORS[end])
        assert self.owner.wait(PATIENCE_S)
        error = ERRORS[end]
        self.state, self.cause = end, None if error is None else error.message

    @precondition(lambda self: self.running)
    @rule()
    def a_defect(self) -> None:
        self.house.puppet.crash(ZeroDivisionError("of ours"))
        assert self.owner.wait(PATIENCE_S)
        self.state, self.cause = S.FAULTED, "internal error of the program"

    @rule()
    def hold(self) -> None:
        self._request("hold", self.owner.hold)

    @rule()
    def resume(self) -> None:
        self._request("resume", self.owner.resume)

    @rule()
    def abort(self) -> None:
        self.owner.abort("pressed")
        self.aborted = self.aborted or self.running

    @rule()
    def reset(self) -> None:
        if self.running:
            with pytest.raises(Busy):
                self.owner.reset()
            return
        self.owner.reset()
        self.state, self.cause = S.IDLE, None

    @rule(number=st.integers(1, 5), yes=st.booleans())
    def answer_what_was_not_asked(self, number, yes) -> None:
        with pytest.raises(UserError, match="no question is open"):
            self.owner.answer(number, yes)

    def _request(self, what, request) -> None:
        if what in ALLOWED[self.state]:
            request()
        else:
            with pytest.raises(UserError, match=what):
                request()

    @invariant()
    def status_is_the_models(self) -> None:
        if not hasattr(self, "owner"):
            return
        status = self.owner.status()
        assert status.state is self.state
        assert status.packml == PACKML[self.state]
        assert status.may == ALLOWED[self.state] - {"resume_run"}
        if self.cause is not None:
            assert self.cause in status.alarms[0].text
            assert len(status.alarms) == 1

    @invariant()
    def never_two_runs(self) -> None:
        if hasattr(self, "house"):
            assert self.house.puppet.most_inside <= 1

    @invariant()
    def an_abort_reaches_the_run(self) -> None:
        if hasattr(self, "house") and self.running:
            assert (self.house.puppet.abort_wanted is not None) is self.aborted

    @invariant()
    def events_have_no_gaps(self) -> None:
        while hasattr(self, "events") and not self.events.empty():
            event = self.events.get_nowait()
            assert event.number == self.last_number + 1
            self.last_number = event.number


TestRequests = Requests.TestCase
TestRequests.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)


def test_every_state_has_its_requests_and_its_name() -> None:
    assert set(ALLOWED) == set(RunState) == set(PACKML)
    assert FINAL <= AT_REST


def test_what_can_be_held_has_a_way_to_held() -> None:
    """Check that a hold is offered exactly in the states from which a run can be held."""
    assert {state for state in RunState if "hold" in ALLOWED[state]} == {
        state for state in RunState if state not in FINAL and may_follow(state, S.HELD)
    }


def test_abort_is_offered_wherever_something_goes_on() -> None:
    assert {state for state in RunState if "abort" in ALLOWED[state]} == set(RunState) - AT_REST - {S.ABORTING}
