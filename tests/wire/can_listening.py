"""Permanent reader of a bus, like the receiving thread of a link or a CAN server."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can


@contextmanager
def listening(bus: can.BusABC) -> Iterator[list[can.Message]]:
    """Collect the messages received on the bus, in order."""
    heard: list[can.Message] = []
    ending = threading.Event()

    def listen() -> None:
        while not ending.is_set():
            message = bus.recv(0.02)
            if message is not None:
                heard.append(message)

    thread = threading.Thread(target=listen)
    thread.start()
    try:
        yield heard
    finally:
        ending.set()
        thread.join(5.0)
