"""Everything that happens, numbered without gaps, for whoever listens: a ring of the latest events, and queues."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from queue import Queue
from typing import Any

from agent.execution.encoding import to_json
from agent.service.control import Event

KEPT = 2000
"""A full calibration makes some 400 events; so a page that was away for a whole run still gets all of it."""
QUEUED = 1000


class EventLog:
    """Any thread may publish and read."""

    def __init__(self, kept: int = KEPT, queued: int = QUEUED) -> None:
        self._ring: deque[Event] = deque(maxlen=kept)
        self._queued = queued
        self._queues: list[Queue[Event]] = []
        self._wakers: list[Callable[[], object]] = []
        self._number = 0
        self._lock = threading.Lock()
        self.closed = False

    def close(self) -> None:
        """Whoever follows is woken and sees that nothing more comes."""
        self.closed = True
        with self._lock:
            wakers = tuple(self._wakers)
        for wake in wakers:
            wake()

    def publish(self, kind: str, text: str, data: Mapping[str, Any] | None = None) -> Event:
        """`data` becomes what JSON can say, as the journal has it."""
        plain = json.loads(to_json(data or {}))
        with self._lock:
            self._number += 1
            event = Event(self._number, kind, text, plain)
            self._ring.append(event)
            for queue in self._queues:
                _put(queue, event, self._queued)
            wakers = tuple(self._wakers)
        for wake in wakers:
            wake()
        return event

    @property
    def last_number(self) -> int:
        with self._lock:
            return self._number

    def since(self, number: int) -> tuple[bool, tuple[Event, ...]]:
        """Events after `number`, and whether some of them are no longer kept (or `number` is of another life of the
        service): then whoever asks must look at the status again."""
        with self._lock:
            first = self._ring[0].number if self._ring else self._number + 1
            lost = number > self._number or number + 1 < first
            return lost, tuple(event for event in self._ring if lost or event.number > number)

    @contextmanager
    def subscribe(self) -> Iterator[Queue[Event]]:
        """A queue of the events from now on."""
        queue: Queue[Event] = Queue()
        with self._lock:
            self._queues.append(queue)
        try:
            yield queue
        finally:
            with self._lock:
                self._queues.remove(queue)

    @contextmanager
    def waking(self, wake: Callable[[], object]) -> Iterator[None]:
        """`wake` is called, on the publisher's thread, after every event; it must return at once."""
        with self._lock:
            self._wakers.append(wake)
        try:
            yield
        finally:
            with self._lock:
                self._wakers.remove(wake)


def _put(queue: Queue[Event], event: Event, limit: int) -> None:
    """Of a queue that nobody empties the oldest progress goes first, then the oldest of all."""
    with queue.mutex:
        waiting = queue.queue
        if len(waiting) >= limit:
            surplus = next((old for old in waiting if old.kind == "progress"), waiting[0])
            waiting.remove(surplus)
    queue.put_nowait(event)
