"""Thread that reads the machine between runs, so that the displayed state is not older than a period.

It is a thread of its own, because a device that does not answer would keep the main loop from feeding systemd's
watchdog.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import structlog

from agent.service.owner.owner import READING_LIMIT_S, Owner

log = structlog.get_logger()

OFF_S = 60.0
"""Interval in s at which the setting is looked at if it switches the reading off."""


@contextmanager
def idle_reading(owner: Owner) -> Iterator[None]:
    """Read the machine once per `service.idle_read_period_s`, and at the end of each run, during the `with` block. At
    its end the owner is closed, and a reading in progress is awaited, so that no device is left in the middle of an
    exchange.
    """

    def work() -> None:
        going_on = True
        while going_on:
            period_s = owner.settings.service.idle_read_period_s
            if period_s > 0.0:
                try:
                    owner.read_idle()
                except Exception:  # the display must not end with one reading
                    log.exception("the idle machine could not be read")
            going_on = owner.await_change(period_s or OFF_S)

    thread = threading.Thread(target=work, name="idle-reader", daemon=True)
    thread.start()
    try:
        yield
    finally:
        owner.close(0.0)
        thread.join(READING_LIMIT_S)
        if thread.is_alive():
            log.warning("the reading of the idle machine did not end")
