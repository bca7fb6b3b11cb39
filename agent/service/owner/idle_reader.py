"""Thread that works between runs. It reads the machine, so that the displayed state is not older than a period. After
each run it compacts old runs and gives the memory of the run back.

It is a thread of its own, because a device that does not answer would keep the main loop from feeding systemd's
watchdog.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime

import structlog

from agent.history.retention import compact, due_runs
from agent.service.owner.machine_use import READING_LIMIT_S
from agent.service.owner.owner import Owner
from agent.service.owner.process_heap import release_free_memory
from drivers.clock import utc_timestamp
from drivers.errors import InputError, VolcalError

log = structlog.get_logger()

OFF_S = 60.0
"""Interval in s at which the setting is looked at if it switches the reading off."""
MOST_COMPACTED = 20
"""Largest number of runs that are compacted at a time. After an update there may be a thousand, and the machine is not
read meanwhile."""


@contextmanager
def idle_reading(owner: Owner) -> Iterator[None]:
    """Read the machine once per `service.idle_read_period_s`, and at the end of each run, during the `with` block. Tidy
    up at its start and at the end of each run. At its end the owner is closed, and a reading in progress is awaited, so
    that no device is left in the middle of an exchange.
    """

    def work() -> None:
        going_on, tidy_after = True, ""
        while going_on:
            status = owner.status()
            last = f"after {status.run_id} {status.started}"  # a resumed run has its former identity
            if not owner.busy and tidy_after != last:
                tidy_after = last
                tidy_up(owner)
            period_s = owner.settings.service.idle_read_period_s
            if period_s > 0.0:
                try:
                    owner.read_idle()
                except Exception:  # the display must not end with one reading
                    log.exception("the idle machine could not be read")
            going_on = owner.use.await_change(period_s or OFF_S)

    thread = threading.Thread(target=work, name="idle-reader", daemon=True)
    thread.start()
    try:
        yield
    finally:
        owner.close(0.0)
        thread.join(READING_LIMIT_S)
        if thread.is_alive():
            log.warning("the reading of the idle machine did not end")


def tidy_up(owner: Owner) -> None:
    """Compact the runs that the settings no longer keep whole, until a run is requested, and give the free memory of
    this process back. What cannot be compacted is logged, and tried again after the next run. A run whose folder cannot
    be read or written does not keep the later ones from being compacted."""
    directory, left = owner.settings.state_directory, list[str]()
    try:
        due = due_runs(directory, owner.settings.history, datetime.fromisoformat(utc_timestamp()))
        for row in due[:MOST_COMPACTED]:
            with owner.use.between_runs("an old run is being compacted") as idle:
                if not idle:
                    break
                try:
                    done = compact(directory, row, write=True)
                except InputError as error:
                    left.append(str(error))
                    continue
            if done is not None:
                log.info("run compacted", run=row.run_id, before_bytes=done.before_bytes, after_bytes=done.after_bytes)
    except VolcalError as error:
        log.warning("old runs not compacted", reason=str(error))
    except Exception:  # the display must not end with a defect here
        log.exception("old runs not compacted")
    if left:
        log.warning("old runs not compacted", runs=len(left), reason=left[0])
    release_free_memory()
