"""Tests of interruptions of the link to a Modbus controller, with a small PLC in virtual time.

While nothing moves, the driver opens the link again and repeats what may be repeated. While an axis moves, a lost link
ends the motion. A motion command is never carried out twice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from modbus_plc import FakePlc
from modbus_rig import opened as opened_with

from agent.errors import Aborted
from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import LinkLost, LinkTimeout, MotionFault, ProtocolError
from drivers.modbus_cnc.device import ModbusCnc
from drivers.roles import RestorableLink

TARGET = np.array([150.0, 200.0, 300.0])
MOTION_CODES = (11, 12, 13, 14, 15)

opened = partial(opened_with, timeout_s=0.05)


@pytest.fixture
def cnc(plc: FakePlc, clock: VirtualClock) -> Iterator[ModbusCnc]:
    with opened(plc, clock) as device:
        yield device


def is_motion(request: bytes) -> bool:
    """Return True for a function 23 request that writes the whole command block with the code of a motion."""
    return request[7] == 23 and request[16] == 46 and int.from_bytes(request[19:21], "big") in MOTION_CODES


def lose(plc: FakePlc, count: int, where: Callable[[bytes], bool] = lambda _: True) -> list[bytes]:
    """Lose the answers to the next `count` requests for which `where` is True; return the list of these requests."""
    lost: list[bytes] = []

    def disturb(request: bytes, answer: bytes) -> bytes | None:
        if len(lost) < count and where(request):
            lost.append(request)
            return None
        return answer

    plc.disturb = disturb
    return lost


def test_two_lost_answers_at_rest_are_repeated(cnc: ModbusCnc, plc: FakePlc) -> None:
    lost = lose(plc, 2)
    assert cnc.position().tolist() == [100.0, 200.0, 300.0]
    assert len(lost) == 2
    assert isinstance(cnc, RestorableLink)
    assert cnc.interruptions() == 1
    assert plc.connections == 2


def test_a_dropped_connection_at_rest_is_opened_again(cnc: ModbusCnc, plc: FakePlc) -> None:
    plc.drop_client()
    cnc.move_to(TARGET, feed_mm_per_s=None, guarded=False)
    assert cnc.position().tolist() == TARGET.tolist()
    assert cnc.interruptions() == 1
    assert plc.commands == [11]


def test_a_motion_command_that_was_taken_is_not_sent_again(cnc: ModbusCnc, plc: FakePlc) -> None:
    """The answer is lost with the connection, after the PLC has taken the command: the axes move, so they stop."""

    def take_and_drop(request: bytes, answer: bytes) -> bytes | None:
        if is_motion(request):
            plc.disturb = lambda _request, answer: answer
            plc.drop_client()
            return None
        return answer

    plc.disturb = take_and_drop
    with pytest.raises(LinkLost, match="interrupted while MOVE RAPID was sent, and the axes have begun to move"):
        cnc.move_to(TARGET, feed_mm_per_s=None, guarded=False)
    assert plc.commands == [11, 23]
    assert sum(map(is_motion, plc.requests)) == 1


def test_a_motion_that_ended_during_the_interruption_is_judged_by_its_outcome(cnc: ModbusCnc, plc: FakePlc) -> None:
    lost = lose(plc, 4, lambda request: is_motion(request) or sum(map(is_motion, plc.requests)) > 0)
    cnc.move_to(np.array([101.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert len(lost) == 4
    assert plc.commands == [11]
    assert cnc.position().tolist() == [101.0, 200.0, 300.0]


def test_a_motion_command_that_was_not_taken_is_sent_again_with_its_number(cnc: ModbusCnc, plc: FakePlc) -> None:
    decide = plc._pdu
    swallowed: list[bytes] = []

    def swallow_the_first(pdu: bytes) -> bytes:
        if is_motion(b"\x00" * 7 + pdu) and not swallowed:
            swallowed.append(pdu)
            plc.drop_client()
            return b"\x97\x04"
        return decide(pdu)

    plc._pdu = swallow_the_first  # type: ignore[method-assign]
    cnc.move_to(TARGET, feed_mm_per_s=None, guarded=False)
    sent = [request for request in plc.requests if is_motion(request)]
    assert [request[-2:] for request in sent] == [b"\x00\x01"] * 2
    assert plc.commands == [11]


def test_a_lost_link_while_an_axis_moves_ends_the_motion(cnc: ModbusCnc, plc: FakePlc, clock: VirtualClock) -> None:
    dropped: list[float] = []

    def drop(now_s: float) -> None:
        if now_s > 0.3 and not dropped:
            dropped.append(now_s)
            plc.drop_client()

    clock.subscribe(drop)
    with pytest.raises(LinkLost, match="connection lost"):
        cnc.move_to(np.array([400.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert cnc.interruptions() == 0
    clock.sleep(2.0)
    assert plc.registers[1005] == 6  # the controller's own watchdog has stopped the axes
    stood_at = plc.triple(1012)
    assert stood_at[0] < 100.0 + 100.0 * (dropped[0] + 1.5)


def test_attempts_are_bounded_in_number_and_time(plc: FakePlc, clock: VirtualClock) -> None:
    with opened(plc, clock, reconnect_attempts=3) as cnc:
        plc.hang_up()
        with pytest.raises(LinkLost, match="3 attempts to restore the link failed"):
            cnc.position()
    assert clock.now() == pytest.approx(0.2 + 0.4 + 0.8)


def test_the_time_of_the_attempts_is_bounded(plc: FakePlc, clock: VirtualClock) -> None:
    with opened(plc, clock, reconnect_attempts=100, reconnect_timeout_s=1.0) as cnc:
        plc.hang_up()
        with pytest.raises(LinkLost, match="3 attempts to restore"):
            cnc.position()
    assert clock.now() == pytest.approx(1.0)


def test_without_attempts_a_lost_link_ends_the_run(plc: FakePlc, clock: VirtualClock) -> None:
    with opened(plc, clock, reconnect_attempts=0) as cnc:
        lose(plc, 2)
        with pytest.raises(LinkTimeout, match="no answer"):
            cnc.position()


def test_a_controller_that_has_restarted_meanwhile_is_not_taken_for_the_same(cnc: ModbusCnc, plc: FakePlc) -> None:
    cnc.stop()
    plc.drop_client()
    plc.registers[1008] = plc.registers[2022] = 0
    with pytest.raises(ProtocolError, match=r"the controller was restarted: it has forgotten command 1"):
        cnc.position()


def test_an_abort_during_the_attempts_ends_them(plc: FakePlc, clock: VirtualClock) -> None:
    def check() -> None:
        if clock.now() > 1.0:
            raise Aborted("asked for")

    with opened(plc, InterruptibleClock(clock, check)) as cnc:
        plc.hang_up()
        with pytest.raises(Aborted):
            cnc.position()
    assert clock.now() < 1.2


def test_a_hold_during_the_attempts_does_no_harm(plc: FakePlc, clock: VirtualClock) -> None:
    asked: list[str] = []
    cnc: ModbusCnc

    def check() -> None:
        if clock.now() > 0.1 and not asked:
            asked.append("hold")
            cnc.hold()
            clock.sleep(30.0)
            began_s = clock.now()
            with pytest.raises(LinkLost):  # at once: only the interrupted request restores the link
                cnc.status()
            assert clock.now() == began_s
            cnc.resume()

    with opened(plc, InterruptibleClock(clock, check)) as cnc:
        plc.drop_client()
        assert cnc.position().tolist() == [100.0, 200.0, 300.0]
    assert asked == ["hold"]
    assert plc.commands == []


def test_the_fault_of_a_motion_lost_with_the_link_is_told(cnc: ModbusCnc, plc: FakePlc) -> None:
    """The command is taken, the link is away for longer than the controller's watchdog of 1 s."""
    lose(plc, 8, lambda _: sum(map(is_motion, plc.requests)) > 0)
    with pytest.raises(MotionFault, match="heartbeat"):
        cnc.move_to(np.array([900.0, 200.0, 300.0]), feed_mm_per_s=None, guarded=False)
    assert plc.commands.count(11) == 1
