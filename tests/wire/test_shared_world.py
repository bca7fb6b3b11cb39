"""One world behind several servers: its lock, its companions, and its source of time."""

from __future__ import annotations

import socket
import threading
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import LockstepClock, ScaledClock
from simulators.wire.shared_world import SharedWorld
from simulators.wire.time_server import Ticker, TimeServer


@dataclass
class Hours:
    now: float = 0.0
    stops: list[float] = field(default_factory=list)
    came: threading.Event = field(default_factory=threading.Event)
    awaited_s: float = float("inf")

    def advance_to(self, instant_s: float) -> None:
        self.now = instant_s
        self.stops.append(instant_s)
        if instant_s >= self.awaited_s:
            self.came.set()


def test_companions_are_moved_and_woken_on_the_way() -> None:
    shared = SharedWorld(Hours())
    seen: list[float] = []
    shared.subscribe(seen.append, wakes_at=lambda: 2.5 if shared.now < 2.5 else None)
    shared.advance_to(10.0)
    shared.advance_to(4.0)
    assert shared.world.stops == seen == [2.5, 10.0]


@given(st.lists(st.floats(0.0, 100.0), max_size=20), st.floats(0.25, 30.0))
def test_a_period_is_kept_whatever_the_steps(instants: list[float], period_s: float) -> None:
    shared = SharedWorld(Hours())
    rings: list[float] = []

    def due() -> float:
        return period_s * (len(rings) + 1)

    def ring(now_s: float) -> None:
        while now_s >= due():
            rings.append(now_s)

    shared.subscribe(ring, wakes_at=due)
    for instant in instants:
        shared.advance_to(instant)
    assert rings == [period_s * (n + 1) for n in range(len(rings))]
    assert due() > shared.now


def test_lockstep_moves_the_world_and_a_second_client_starts_where_time_is() -> None:
    shared = SharedWorld(Hours())
    server = TimeServer(shared, ("127.0.0.1", 0))
    server.start()
    first = LockstepClock(*server.address)
    first.sleep(100.0)
    first.sleep(0.125)
    assert shared.now == 100.125
    first.close()
    second = LockstepClock(*server.address)
    second.sleep(0.25)
    assert second.now() == 0.25
    assert shared.now == 100.375
    second.close()
    server.close()


@pytest.mark.parametrize(
    "line", [b"advance", b"advance x", b"advance nan", b"advance inf", b"jump 1", b"", b"\xff\xfe"]
)
def test_lockstep_refuses_what_it_does_not_know(line: bytes) -> None:
    shared = SharedWorld(Hours())
    server = TimeServer(shared, ("127.0.0.1", 0))
    server.start()
    with socket.create_connection(server.address, timeout=600.0) as link, link.makefile("rb") as answers:
        link.sendall(line + b"\nadvance 1.5\n")
        assert answers.readline().startswith(b"error")
        assert answers.readline() == b"ok\n"
    assert shared.now == 1.5
    server.close()


def test_ticker_follows_a_scaled_clock() -> None:
    world = Hours(awaited_s=1.0)
    ticker = Ticker(SharedWorld(world), ScaledClock(100.0))
    ticker.start()
    assert world.came.wait(5.0)
    ticker.close()
    assert world.stops == sorted(world.stops)


def test_the_lock_keeps_others_out_of_an_advance() -> None:
    shared = SharedWorld(Hours())
    inside, leave = threading.Event(), threading.Event()

    def linger(_now_s: float) -> None:
        inside.set()
        leave.wait(5.0)

    shared.subscribe(linger)
    advance = threading.Thread(target=shared.advance_to, args=(1.0,))
    advance.start()
    assert inside.wait(5.0)
    assert not shared.lock.acquire(timeout=0.01)
    leave.set()
    advance.join(5.0)
    assert shared.lock.acquire(timeout=600.0)
    shared.lock.release()
