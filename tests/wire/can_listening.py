"""Somebody who is in a bus's `recv` all the time, as the receiving thread of a link and a CAN server are."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can


@contextmanager
def listening(bus: can.BusABC) -> Iterator[list[can.Message]]:
    """What the bus hears, in order."""
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
