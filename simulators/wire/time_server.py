"""Sources of machine time for simulators that run as a separate process.

In lockstep the agent controls time (`drivers.clock.LockstepClock`). The agent sends the line ``advance SECONDS``, the
server advances the simulated world to that instant of the agent's clock, and then answers with ``ok``. Without lockstep
a thread (`Ticker`) advances the world with the wall clock.
"""

from __future__ import annotations

import math
import socket
import threading

from drivers.clock import Clock
from simulators.wire.shared_world import SharedWorld, TimeDriven
from simulators.wire.tcp_server import TcpServer, serve_lines

TICK_S = 0.002
"""Wall time in s between two advances: a tenth of the fastest cyclic message (20 ms) on the simulated links."""


class TimeServer:
    """TCP server through which an agent advances machine time in lockstep: machine time passes only when the agent
    requests it.

    The clock of each agent starts at zero, so its seconds are counted from the machine time at which the agent
    connected. If they were counted from machine time 0, time would stand still for a second agent until its clock had
    passed the machine time that the first agent had reached.
    """

    def __init__(self, shared: SharedWorld[TimeDriven], address: tuple[str, int]) -> None:
        self._shared = shared
        self._server = TcpServer("time", address, self._serve)
        self.address = self._server.address
        self.start = self._server.start
        self.close = self._server.close

    def _serve(self, connection: socket.socket) -> None:
        origin_s = self._shared.now

        def answer(line: bytes) -> bytes:
            instant_s = _parse_advance(line)
            if instant_s is None:
                return b"error expected: advance SECONDS"
            self._shared.advance_to(origin_s + instant_s)
            return b"ok"

        serve_lines(connection, answer)


def _parse_advance(line: bytes) -> float | None:
    words = line.split()
    if len(words) != 2 or words[0] != b"advance":
        return None
    try:
        instant_s = float(words[1])
    except ValueError:
        return None
    return instant_s if math.isfinite(instant_s) else None


class Ticker:
    """Thread that advances the simulated world in small steps of time with `clock`, a wall clock in real or scaled
    time.
    """

    def __init__(self, shared: SharedWorld[TimeDriven], clock: Clock) -> None:
        self._shared = shared
        self._clock = clock
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ticker", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        origin_s = self._shared.now - self._clock.now()
        while not self._stop.wait(TICK_S):
            self._shared.advance_to(origin_s + self._clock.now())
