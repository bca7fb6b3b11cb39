"""A held run is resumed only when the axes have braked, and not at all after an abort."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.errors import Aborted
from agent.execution.rig import STANDSTILL_POLL_S, STANDSTILL_WITHIN_S, Rig
from agent.execution.run_state import RunStateTracker
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.runs.session import open_rig
from agent.service.allowed_requests import allowed_in
from drivers.clock import INTERRUPT_SLICE_S, InterruptibleClock, VirtualClock
from drivers.errors import LinkLost
from drivers.roles import MotionState

HOLD_S, RESUME_S = 1.0, 2.0
LONGEST_S = 60.0


class Machine:
    """Machine that stands still `braking_s` after a resumption was requested, and takes a note of what it is told."""

    def __init__(self, clock: VirtualClock, braking_s: float) -> None:
        self._clock, self._stands_s = clock, RESUME_S + braking_s
        self.told: list[tuple[str, float]] = []
        self.lost = False

    def status(self) -> Any:
        if self.lost:
            raise LinkLost("the link is being restored")
        return SimpleNamespace(state=MotionState.HELD if self._clock.now() >= self._stands_s else MotionState.MOVING)

    def __getattr__(self, name: str) -> Any:
        return lambda: self.told.append((name, self._clock.now()))


class Journal:
    """Journal that keeps nothing."""

    def state(self, state: RunState, reason: str, *, final: bool) -> None:
        pass

    def event(self, kind: str, record: object) -> None:
        pass


class Held:
    """Wait of a run that is held at `HOLD_S` and resumed at `RESUME_S`."""

    def __init__(self, braking_s: float) -> None:
        self.inner = VirtualClock()
        self.supervisor = Supervisor(self.inner)
        self.machine: Any = Machine(self.inner, braking_s)
        clock = InterruptibleClock(self.inner, self.supervisor.check)
        self.rig = Rig({}, self.machine, self.machine, {}, self.machine, self.machine, self.machine, clock)
        tracker = SimpleNamespace(may_hold=lambda: True, hold=lambda: None, resume=lambda: None, note=None)
        self._context: Any = SimpleNamespace(rig=self.rig, tracker=tracker, supervisor=self.supervisor)
        self._clock = clock
        self.inner.subscribe(self._ask)

    def _ask(self, now_s: float) -> None:
        if HOLD_S <= now_s < RESUME_S:
            self.supervisor.request_hold()
        elif now_s >= RESUME_S:
            self.supervisor.request_resume()

    def wait(self) -> None:
        with open_rig(self._context):
            self._clock.sleep(5.0)

    @property
    def told(self) -> list[str]:
        return [name for name, _ in self.machine.told]


def test_the_machine_is_resumed_when_its_axes_have_braked() -> None:
    held = Held(0.7)
    held.wait()
    assert held.told == ["hold", "resume"]
    assert held.machine.told[1][1] == pytest.approx(RESUME_S + 0.7, abs=2.0 * STANDSTILL_POLL_S)


@pytest.mark.parametrize("braking_s", [0.7, 100.0], ids=["braking", "cannot be held"])
def test_an_abort_while_the_axes_brake_takes_effect_at_once_and_the_machine_is_not_resumed(braking_s: float) -> None:
    held = Held(braking_s)
    abort_s = RESUME_S + 0.3
    held.inner.subscribe(lambda now_s: held.supervisor.request_abort("pressed") if now_s >= abort_s else None)
    with pytest.raises(Aborted, match="pressed"):
        held.wait()
    assert held.told == ["hold"]
    assert held.inner.now() <= abort_s + STANDSTILL_POLL_S + INTERRUPT_SLICE_S


def test_a_hold_while_the_axes_brake_goes_on_without_a_resumption_between() -> None:
    held = Held(0.7)
    again_s, released_s = RESUME_S + 0.3, RESUME_S + 10.0

    def press(now_s: float) -> None:
        if again_s <= now_s < released_s:
            held.supervisor.request_hold()

    held.inner.subscribe(press)
    held.wait()
    assert held.told == ["hold", "resume"]
    assert held.machine.told[1][1] == pytest.approx(released_s, abs=2.0 * STANDSTILL_POLL_S)


def test_a_hold_at_the_end_of_a_measurement_waits_for_a_state_in_which_the_run_can_be_resumed() -> None:
    held, journal = Held(0.0), Journal()
    entered: list[str] = []
    tracker = RunStateTracker(journal, lambda told: entered.append(told.text))  # type: ignore[arg-type]
    supervisor = Supervisor(held.inner)
    held.rig.clock = clock = InterruptibleClock(held.inner, supervisor.check)
    context: Any = SimpleNamespace(rig=held.rig, tracker=tracker, supervisor=supervisor)
    for state in (RunState.PREFLIGHT, RunState.MEASURING):
        tracker.enter(state)

    def press(now_s: float) -> None:
        if "resume" in allowed_in(tracker.state, unfinished=False, question_open=False):
            supervisor.request_resume()
        elif now_s >= LONGEST_S:
            supervisor.request_abort(f"nobody can resume the run in the state {tracker.state.value}")

    held.inner.subscribe(press)
    with open_rig(context):
        supervisor.request_hold()  # by somebody to whom the run was still measuring
        for state in (RunState.IDENTIFYING, RunState.STAGING, RunState.ACTIVATING):
            tracker.enter(state)
            clock.sleep(1.0)
        assert held.told == []
        tracker.enter(RunState.VERIFYING)
        clock.sleep(1.0)
    assert held.told == ["hold", "resume"]
    assert entered[-3:] == ["verifying", "held", "verifying"]


def test_a_motion_that_cannot_be_held_goes_on() -> None:
    held = Held(10.0 * STANDSTILL_WITHIN_S)
    held.wait()
    assert held.told == ["hold", "resume"]


def test_a_link_that_is_being_restored_does_not_delay_the_resumption() -> None:
    held = Held(0.7)
    held.machine.lost = True
    held.wait()
    assert held.machine.told[1][1] == pytest.approx(RESUME_S, abs=2.0 * STANDSTILL_POLL_S)


def test_a_turn_of_a_mount_is_held_and_resumed_once_though_it_serves_two_stations() -> None:
    held = Held(0.7)
    told: list[tuple[str, float]] = []

    class Mount:
        def hold_turn(self) -> None:
            told.append(("hold", held.inner.now()))

        def resume_turn(self) -> None:
            told.append(("resume", held.inner.now()))

    mount: Any = Mount()
    held.rig.mounts = {1: mount, 2: mount}
    held.wait()
    assert [name for name, _ in told] == ["hold", "resume"]
    assert [instant_s for _, instant_s in told] == [instant_s for _, instant_s in held.machine.told]
