"""Hold and abort are noticed in waits, within one slice, and held time does not count against deadlines."""

from __future__ import annotations

import pytest

from agent.errors import Aborted, Interrupted
from agent.execution.supervisor import Supervisor
from drivers.clock import INTERRUPT_SLICE_S, Deadline, InterruptibleClock, VirtualClock


def test_an_abort_is_noticed_within_a_slice() -> None:
    inner = VirtualClock()
    supervisor = Supervisor(inner)
    clock = InterruptibleClock(inner, supervisor.check)
    inner.subscribe(lambda now: supervisor.request_abort("button") if now >= 1.0 else None)
    with pytest.raises(Aborted, match="button"):
        clock.sleep(60.0)
    assert inner.now() <= 1.0 + INTERRUPT_SLICE_S + 1e-9


def test_the_first_reason_of_an_abort_stays() -> None:
    supervisor = Supervisor(VirtualClock())
    supervisor.request_abort("first")
    supervisor.request_abort("second")
    with pytest.raises(Aborted, match="first"):
        supervisor.check()


def test_a_hold_stops_the_machine_and_does_not_count_against_a_deadline() -> None:
    inner = VirtualClock()
    supervisor = Supervisor(inner)
    clock = InterruptibleClock(inner, supervisor.check)
    calls: list[tuple[str, float]] = []
    supervisor.on_hold = lambda: calls.append(("hold", inner.now()))
    supervisor.on_resume = lambda: calls.append(("resume", inner.now()))

    def people(now: float) -> None:
        if 1.0 <= now < 1.04:
            supervisor.request_hold()
        if now >= 31.0:
            supervisor.request_resume()

    inner.subscribe(people)
    deadline = Deadline.after(clock, 5.0)
    clock.sleep(3.0)
    assert [name for name, _ in calls] == ["hold", "resume"]
    assert inner.now() > 31.0
    assert not deadline.expired
    assert deadline.remaining_s == pytest.approx(2.0, abs=INTERRUPT_SLICE_S)


def test_an_abort_ends_a_hold() -> None:
    inner = VirtualClock()
    supervisor = Supervisor(inner)
    supervisor.request_hold()
    inner.subscribe(lambda now: supervisor.request_abort("enough") if now > 2.0 else None)
    with pytest.raises(Aborted, match="enough"):
        InterruptibleClock(inner, supervisor.check).sleep(1.0)


def test_an_interruption_is_not_an_abort() -> None:
    supervisor = Supervisor(VirtualClock())
    supervisor.request_interruption("a reboot")
    supervisor.request_abort("button")
    with pytest.raises(Interrupted, match="a reboot"):
        supervisor.check()
    with pytest.raises(Interrupted):
        supervisor.check_stop_request()


def test_while_nothing_moves_an_abort_raises_and_a_hold_does_not_block() -> None:
    supervisor = Supervisor(VirtualClock())
    supervisor.request_hold()
    supervisor.check_stop_request()
    supervisor.request_abort("button")
    with pytest.raises(Aborted, match="button"):
        supervisor.check_stop_request()


def test_the_exit_path_is_not_interrupted_again() -> None:
    inner = VirtualClock()
    supervisor = Supervisor(inner)
    supervisor.request_abort("button")
    supervisor.shield()
    InterruptibleClock(inner, supervisor.check).sleep(1.0)
    assert inner.now() == pytest.approx(1.0)
