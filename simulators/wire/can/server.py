"""Simulated CANopen nodes on a python-can bus. A thread answers requests, and a method advances the nodes' time."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Self

import can
import structlog

from simulators.wire.can.node import CanopenNode, Frame

RECEIVE_CYCLE_S = 0.1

_log = structlog.get_logger("can_server")


class CanServer:
    """Server that connects `nodes` to `bus`. Closing the server shuts the bus down.

    `lock` protects the world behind the nodes and is held while the nodes answer. Code that advances the world from
    another thread must hold the same (re-entrant) lock. `advance` must be called after each advance of the world.
    """

    def __init__(
        self,
        bus: can.BusABC,
        nodes: Sequence[CanopenNode],
        lock: AbstractContextManager[bool] | None = None,
    ) -> None:
        self._bus = bus
        self._nodes = tuple(nodes)
        self._lock = threading.RLock() if lock is None else lock
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="CAN nodes", daemon=True)
        self.failure: Exception | None = None

    def start(self) -> Self:
        for node in self._nodes:
            with self._lock:
                self._send(node.boot())
        self._thread.start()
        return self

    def advance(self, now_s: float) -> None:
        """Set the time of all nodes to `now_s`, and send the heartbeats and emergency messages that they must send
        until then.
        """
        with self._lock:
            for node in self._nodes:
                self._send(node.advance(now_s))

    def restart(self, node: CanopenNode) -> None:
        """Power-cycle one node."""
        with self._lock:
            self._send(node.boot())

    def close(self) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(10.0 * RECEIVE_CYCLE_S)
        self._bus.shutdown()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _serve(self) -> None:
        while not self._stopping.is_set():
            try:
                message = self._bus.recv(RECEIVE_CYCLE_S)
                if message is not None and not (message.is_extended_id or message.is_error_frame):
                    self._answer(message)
            except (can.CanError, OSError) as error:
                self.failure = error
                _log.error("CAN bus failed", error=str(error))
                return

    def _answer(self, message: can.Message) -> None:
        if message.is_remote_frame:
            return
        with self._lock:
            for node in self._nodes:
                self._send(node.receive(message.arbitration_id, bytes(message.data)))

    def _send(self, frames: Sequence[Frame]) -> None:
        for identifier, data in frames:
            self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
