"""The reports of runs: each made by a process of its own, one after the other, when the machine is free again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue

import structlog

from agent.files import write_all_atomically
from agent.reports.render_in_subprocess import made_apart
from drivers.errors import VolcalError

log = structlog.get_logger()

REPORT = "report.html"


def none_yet(directory: Path, run_id: str) -> Mapping[str, str | bytes]:
    """`agent.reports.renderer.Reports` of a run that is to end without waiting for its report."""
    return {}


class Reports:
    """Any thread may ask. What the service does not come to before it is closed is made when somebody asks for it."""

    def __init__(self, directory: Path, make: Callable[[Path, str], Mapping[str, str | bytes]] = made_apart) -> None:
        self._directory = directory
        self._make = make
        self._making = threading.Lock()
        self._asking = threading.Lock()
        self._awaited: set[str] = set()
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closed = False

    def wanted(self, run_id: str) -> None:
        """The run has ended; returns at once. The report from before it went on is taken away: were this process to end
        now, nobody would know that it is too old."""
        with self._asking:
            self._awaited.add(run_id)
            self._take_away(self._directory / run_id / REPORT)
            if self._closed:
                return
            self._queue.put(run_id)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="reports", daemon=True)
                self._thread.start()

    def path(self, run_id: str) -> Path:
        """The file, made now where it is missing or older than the run's end. Raises as `made_apart`."""
        path = self._directory / run_id / REPORT
        with self._making:
            if run_id in self._awaited or not path.is_file():
                self._awaited.discard(run_id)  # first: the run may go on and end again while it is drawn
                try:
                    write_all_atomically(path.parent, self._make(self._directory, run_id))
                except BaseException:
                    self._awaited.add(run_id)
                    raise
        return path

    def close(self, within_s: float) -> bool:
        """Begin no more; whether the one being made was ended in time."""
        with self._asking:
            self._closed = True
            self._queue.put(None)
            thread = self._thread
        if thread is not None:
            thread.join(within_s)
        return thread is None or not thread.is_alive()

    def _take_away(self, old: Path) -> None:
        try:
            old.unlink(missing_ok=True)
        except OSError as error:
            log.warning("an old report stays", path=str(old), reason=str(error))

    def _work(self) -> None:
        while (run_id := self._queue.get()) is not None and not self._closed:
            try:
                self.path(run_id)
            except VolcalError as error:
                log.warning("no report", run_id=run_id, reason=str(error))
