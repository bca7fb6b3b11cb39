"""Numbered events of the service. A ring buffer contains the latest events, and each subscriber has a queue of its
own."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from queue import Queue
from typing import Any

from agent.execution.encoding import to_json
from agent.service.control import Event

MOST_EVENTS = 2000
"""A full calibration produces about 400 events, so a page that was disconnected during a whole run can get all of
them."""
MOST_QUEUED = 1000
MS_PER_S = 1e3


class EventLog:
    """Log of the service's events. Any thread may publish and read.

    The first event has the number after `after`. The numbers of two logs must not overlap: a reader that knows a number
    of the former log must not take it for one of this log.
    """

    def __init__(self, retained: int = MOST_EVENTS, queue_limit: int = MOST_QUEUED, after: int = 0) -> None:
        self._ring: deque[Event] = deque(maxlen=retained)
        self._queue_limit = queue_limit
        self._queues: list[Queue[Event]] = []
        self._callbacks: list[Callable[[], object]] = []
        self._number = after
        self._lock = threading.Lock()
        self.closed = False

    def close(self) -> None:
        """Close the log and wake all readers. They then find that the attribute `closed` is True."""
        self.closed = True
        with self._lock:
            callbacks = tuple(self._callbacks)
        for callback in callbacks:
            callback()

    def publish(self, kind: str, text: str, data: Mapping[str, Any] | None = None) -> Event:
        """Append an event to the log and return it. `data` is converted to JSON values as for the journal."""
        plain = json.loads(to_json(data or {}))
        with self._lock:
            self._number += 1
            event = Event(self._number, kind, text, plain)
            self._ring.append(event)
            for queue in self._queues:
                _put(queue, event, self._queue_limit)
            callbacks = tuple(self._callbacks)
        for callback in callbacks:
            callback()
        return event

    @property
    def last_number(self) -> int:
        with self._lock:
            return self._number

    def since(self, number: int) -> tuple[bool, tuple[Event, ...]]:
        """Return the pair (lost, events), in which the events are those with a number above `number`.

        The first part is True if some of these events are no longer in the ring buffer of the log, or if `number` dates
        from before a restart of the service. In both cases all events in the buffer are returned, and the reader must
        fetch the status again.
        """
        with self._lock:
            first = self._ring[0].number if self._ring else self._number + 1
            lost = number > self._number or number + 1 < first
            return lost, tuple(event for event in self._ring if lost or event.number > number)

    @contextmanager
    def subscribe(self) -> Iterator[Queue[Event]]:
        """Yield a queue that receives all events until the `with` block ends."""
        queue: Queue[Event] = Queue()
        with self._lock:
            self._queues.append(queue)
        try:
            yield queue
        finally:
            with self._lock:
                self._queues.remove(queue)

    @contextmanager
    def call_on_event(self, callback: Callable[[], object]) -> Iterator[None]:
        """Call `callback` after every event and on `close`, for the duration of the `with` block.

        `callback` is called in the thread that publishes the event or closes the log, and must return at once.
        """
        with self._lock:
            self._callbacks.append(callback)
        try:
            yield
        finally:
            with self._lock:
                self._callbacks.remove(callback)


def new_event_log(started: datetime) -> EventLog:
    """Return the log of a service that was started at the time `started`. It numbers its events from the milliseconds
    since 1970, so that no number of the former process of the service occurs again."""
    return EventLog(after=int(MS_PER_S * started.timestamp()))


def _put(queue: Queue[Event], event: Event, limit: int) -> None:
    """Append an event to the queue. If the queue is full, first remove its oldest progress event or, if it contains
    none, its oldest event.
    """
    with queue.mutex:
        waiting = queue.queue
        if len(waiting) >= limit:
            surplus = next((old for old in waiting if old.kind == "progress"), waiting[0])
            waiting.remove(surplus)
    queue.put_nowait(event)
