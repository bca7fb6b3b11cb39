"""The reports of runs: each made by a process of its own, one after the other, when the machine is free again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue

import structlog

from agent.files import write_all_atomically
from agent.reporting.apart import made_apart
from drivers.errors import VolcalError

log = structlog.get_logger()

REPORT = "report.html"


def none_yet(directory: Path, run_id: str) -> Mapping[str, str | bytes]:
    """`agent.reporting.making.Reports` of a run that is to end without waiting for its report."""
    return {}


class Reports:
    """Any thread may ask. What the service does not come to before it ends is made when somebody asks for it."""

    def __init__(self, directory: Path, make: Callable[[Path, str], Mapping[str, str | bytes]] = made_apart) -> None:
        self._directory = directory
        self._make = make
        self._making = threading.Lock()
        self._awaited: set[str] = set()
        self._queue: SimpleQueue[str] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def wanted(self, run_id: str) -> None:
        """The run has ended; returns at once."""
        self._awaited.add(run_id)
        self._queue.put(run_id)
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="reports", daemon=True)
            self._thread.start()

    def path(self, run_id: str) -> Path:
        """The file, made now where it is missing or older than the run's end. Raises as `made_apart`."""
        path = self._directory / run_id / REPORT
        with self._making:
            if run_id in self._awaited or not path.is_file():
                write_all_atomically(path.parent, self._make(self._directory, run_id))
                self._awaited.discard(run_id)
        return path

    def _work(self) -> None:
        while True:
            run_id = self._queue.get()
            try:
                self.path(run_id)
            except VolcalError as error:
                log.warning("no report", run_id=run_id, reason=str(error))
