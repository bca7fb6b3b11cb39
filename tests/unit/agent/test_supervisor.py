"""Hold and abort are noticed in waits, within one slice, and held time does not count against deadlines."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from agent.cli.run_commands.local_run import interruptible
from agent.errors import Aborted, Interrupted, RunError
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


@contextmanager
def hang_up_means(handler: Any) -> Iterator[None]:
    former = signal.signal(signal.SIGHUP, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, former)


@pytest.mark.parametrize(
    ("number", "end"), [(signal.SIGINT, Aborted), (signal.SIGTERM, Interrupted), (signal.SIGHUP, Interrupted)]
)
@pytest.mark.parametrize("before", [False, True])
def test_a_signal_ends_the_run_also_if_it_comes_before_the_run(
    number: signal.Signals, end: type[RunError], before: bool
) -> None:
    supervisor, resumed = Supervisor(VirtualClock()), Supervisor(VirtualClock())
    with hang_up_means(lambda *_: None), interruptible() as signals:
        if before:
            os.kill(os.getpid(), number)
        signals.attach(supervisor)
        if not before:
            os.kill(os.getpid(), number)
        os.kill(os.getpid(), signal.SIGTERM)
        signals.attach(resumed)  # of the same run, which is resumed once more
    for one in (supervisor, resumed):
        with pytest.raises(end, match=f"ed: {number.name}"):
            one.check()


def test_after_the_run_a_signal_means_what_it_meant_before() -> None:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    former = [signal.getsignal(number) for number in numbers]
    with interruptible():
        pass
    assert [signal.getsignal(number) for number in numbers] == former


def test_a_run_that_is_to_outlive_its_terminal_is_not_ended_when_the_terminal_hangs_up() -> None:
    supervisor = Supervisor(VirtualClock())
    with hang_up_means(signal.SIG_IGN), interruptible() as signals:
        signals.attach(supervisor)
        os.kill(os.getpid(), signal.SIGHUP)
    supervisor.check()
