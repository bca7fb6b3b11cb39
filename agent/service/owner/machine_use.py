"""Use of the machine: by one run at a time, by work between two runs such as a reading, or by nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from agent.errors import Busy
from agent.service.owner.run_mailbox import RunMailbox

READING_LIMIT_S = 30.0
"""Longest time in s that a request waits for a reading of the idle machine, or for the compaction of an old run."""


class MachineUse:
    """Use of the machine by a run, by work between runs, or by nothing; and whether the service is being stopped.

    `lock` guards it. It can be entered again by the thread that holds it, so that a caller can decide and act in one
    step. It also tells those who wait that the use has changed.
    """

    def __init__(self) -> None:
        self.lock = threading.Condition(threading.RLock())
        self._running: RunMailbox | None = None
        self._work = ""
        self._closing = False

    @property
    def running(self) -> RunMailbox | None:
        """Mailbox of the run that uses the machine."""
        return self._running

    # ------------------------------------------------------------------ by a run

    def require_service(self) -> None:
        """Raise Busy if the service is being stopped."""
        if self._closing:
            raise Busy("the service is being stopped", hint="start the service again")

    def require_no_run(self) -> None:
        """Raise Busy if a run uses the machine."""
        if self._running is not None:
            raise Busy(f"run {self._running.run_id} is in progress", hint="wait until it ends or abort it")

    def occupy(self, running: RunMailbox) -> None:
        """Let the run have the machine as soon as the work between runs has ended. Raise Busy if it does not end, or if
        the service is being stopped meanwhile; the machine then is not used."""
        with self.lock:
            self._running = running
            try:
                self.await_work()
                self.require_service()  # it may have been stopped meanwhile
            except Busy:
                self.release()
                raise

    def release(self) -> None:
        """End the use by a run, and tell those who wait."""
        with self.lock:
            self._running = None
            self.lock.notify_all()

    # ------------------------------------------------------------------ between runs

    @contextmanager
    def between_runs(self, work: str) -> Iterator[bool]:
        """Do work between two runs in the `with` block, for which `work` is a sentence; a run that is requested
        meanwhile waits for the end of the block. The block gets False, and must do nothing, while a run is in progress,
        while other such work is, and once the service is being stopped."""
        with self.lock:
            idle = self._running is None and not self._work and not self._closing
            if idle:
                self._work = work
        try:
            yield idle
        finally:
            if idle:
                with self.lock:
                    self._work = ""
                    self.lock.notify_all()

    def await_work(self) -> None:
        """Wait until no work between runs is in progress; the caller holds the lock, which is released meanwhile. Raise
        Busy if it has not ended after `READING_LIMIT_S`."""
        if not self.lock.wait_for(lambda: not self._work, READING_LIMIT_S):
            raise Busy(
                f"{self._work}, and this has not ended after {READING_LIMIT_S:g} s",
                hint="a device or the disk answers slowly or not at all (`volcal doctor` names it); try again",
            )

    # ------------------------------------------------------------------ waiting

    def wait(self, within_s: float) -> bool:
        """Wait at most `within_s` until no run is in progress. Return True if no run is in progress any longer."""
        with self.lock:
            return self.lock.wait_for(lambda: self._running is None, within_s)

    def await_change(self, within_s: float) -> bool:
        """Return at the end of a run, when the service is being stopped, and after `within_s` at the latest. The result
        is False if the service is being stopped."""
        with self.lock:
            if not self._closing:
                self.lock.wait(within_s)
            return not self._closing

    def close(self) -> None:
        """Refuse all further use. The use by a run in progress goes on until it is released."""
        with self.lock:
            self._closing = True
            self.lock.notify_all()  # whoever works between runs ends
