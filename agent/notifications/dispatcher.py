"""Delivery of the notices of the outbox: one thread for each channel, with growing pauses between the attempts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import structlog

from agent.notifications.connection import Channel, DeliveryFailed, NoticeRefused
from agent.notifications.notice import Notice
from agent.notifications.outbox import Outbox, is_older
from drivers.clock import RealClock

log = structlog.get_logger()

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 900.0
_GROWTH = 2.0


Delivery = Literal["delivers", "partial", "fails"]
"""How a channel delivers: everything, only in part (a receiver took a notice for some addressees), or nothing."""


@dataclass(frozen=True)
class ReceiverState:
    """State of a channel. `waiting` is the number of notices that it has not delivered yet. `delivery` is the result of
    the last attempt; if it did not deliver everything, `problem` is the reason, and `since` the UTC time of the first
    of the attempts in a row with this result. Both are empty otherwise."""

    channel: str
    waiting: int = 0
    delivery: Delivery = "delivers"
    problem: str = ""
    since: str = ""


def _utc_now() -> datetime:
    return datetime.now(UTC)


class Courier:
    """Delivery by one channel, without a thread: each call of `attempt` delivers at most one notice.

    `now` returns a monotonic time in s and `utc_now` the UTC time. `changed` is called when the state of the channel
    has changed, and `note` with a text when it begins to fail or to deliver only in part,
    delivers again or drops a notice.
    """

    def __init__(
        self,
        name: str,
        channel: Channel,
        outbox: Outbox,
        max_age_hours: float,
        changed: Callable[[ReceiverState], object],
        note: Callable[[str], object],
        now: Callable[[], float] | None = None,
        utc_now: Callable[[], datetime] = _utc_now,
    ) -> None:
        self.name = name
        self._channel = channel
        self._outbox = outbox
        self._max_age_hours = max_age_hours
        self._changed = changed
        self._note = note
        self._now = RealClock().now if now is None else now
        self._utc_now = utc_now
        self._not_before_s = float("-inf")
        self._pause_s = FIRST_PAUSE_S
        self._delivery: Delivery = "delivers"
        self._problem = self._since = ""
        self._shown = ReceiverState(name)

    def attempt(self) -> float | None:
        """Deliver the next notice if one waits and the pause after the last failure is over.

        Return the time in s until the next call has something to do: 0 for at once, None if nothing waits.
        """
        self._drop_old()
        notice = self._outbox.next_for(self.name)
        if notice is None:
            self._show_if_changed()
            return None
        if (left_s := self._not_before_s - self._now()) > 0.0:
            self._show_if_changed()
            return left_s
        try:
            complaint = self._channel.send(notice)
        except NoticeRefused as error:
            self._outbox.postpone(notice)  # an alarm must not wait behind it until it is too old
            self._failed(str(error))
        except DeliveryFailed as error:
            self._failed(str(error))
        except Exception as defect:  # a defect in a channel must not end the deliveries, and never a run
            log.exception("defect in a channel", channel=self.name)
            self._failed(f"defect in the channel: {type(defect).__name__}")
        else:
            self._delivered(notice, complaint)
            return 0.0
        return self._pause_s

    def state(self) -> ReceiverState:
        return ReceiverState(self.name, self._outbox.count(self.name), self._delivery, self._problem, self._since)

    def _drop_old(self) -> None:
        while (notice := self._outbox.next_for(self.name)) is not None and is_older(
            notice, self._max_age_hours, self._utc_now()
        ):
            self._outbox.remove(notice, self.name)
            self._tell(f"dropped by {self.name} after {self._max_age_hours:g} h: {notice.subject} ({notice.at})")

    def _failed(self, problem: str) -> None:
        failed_before = self._delivery == "fails"
        self._pause_s = min(self._pause_s * _GROWTH, LONGEST_PAUSE_S) if failed_before else FIRST_PAUSE_S
        self._not_before_s = self._now() + self._pause_s
        self._set_delivery("fails", problem)
        self._show()
        if not failed_before:  # once for each disturbance, however many attempts it takes
            self._tell(f"{self.name} does not deliver; it is tried again: {problem}")

    def _delivered(self, notice: Notice, complaint: str) -> None:
        self._outbox.remove(notice, self.name)
        self._not_before_s = float("-inf")
        former = self._delivery, self._problem
        self._set_delivery("partial" if complaint else "delivers", complaint)
        self._show()
        if complaint and (self._delivery, self._problem) != former:
            self._tell(f"{self.name} delivers only in part: {complaint}")
        elif not complaint and former[0] != "delivers":
            self._note(f"notifications: {self.name} delivers again")
            log.info("a channel delivers again", channel=self.name)

    def _set_delivery(self, delivery: Delivery, problem: str) -> None:
        if delivery != self._delivery:
            self._since = "" if delivery == "delivers" else f"{self._utc_now():%Y-%m-%dT%H:%M:%SZ}"
        self._delivery, self._problem = delivery, problem

    def _show_if_changed(self) -> None:
        """Show that notices were dropped, or that more have come during a pause."""
        if self.state() != self._shown:
            self._show()

    def _show(self) -> None:
        self._shown = self.state()
        self._changed(self._shown)

    def _tell(self, text: str) -> None:
        self._note(f"notifications: {text}")
        log.warning("notifications", text=text)


class Dispatcher:
    """Threads that deliver the notices of an outbox. They are daemon threads: they end neither late nor a run."""

    def __init__(self, outbox: Outbox, couriers: Mapping[str, Courier]) -> None:
        self._outbox = outbox
        self._couriers = dict(couriers)
        self._wake = threading.Condition()
        self._puts = 0
        self._closed = False
        self._threads = [
            threading.Thread(target=self._work, args=(courier,), name=f"notifications {name}", daemon=True)
            for name, courier in self._couriers.items()
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def put(self, notice: Notice, channels: tuple[str, ...], *, replaces: bool = False) -> None:
        """Store a notice for `channels` and return; it is delivered later."""
        if channels and self._outbox.put(notice, channels, replaces=replaces):
            with self._wake:
                self._puts += 1
                self._wake.notify_all()

    def close(self, within_s: float) -> bool:
        """Begin no further delivery unless it can be made at once, and wait at most `within_s` for those in progress.
        Return True if every thread has ended. Notices that still wait are delivered after the next start."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()
        clock = RealClock()
        end_s = clock.now() + within_s
        for thread in self._threads:
            thread.join(max(end_s - clock.now(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def _work(self, courier: Courier) -> None:
        while True:
            with self._wake:
                seen = self._puts
            wait_s = courier.attempt()
            if wait_s == 0.0:
                continue
            with self._wake:
                if self._closed:
                    return
                self._wake.wait_for(lambda: self._closed or self._puts != seen, wait_s)  # noqa: B023
