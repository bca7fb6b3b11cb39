"""Queue of the reports of runs. The reports are rendered one after the other in subprocesses while no run uses the
machine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue

import structlog

from agent.files import write_all_atomically
from agent.reports.render_in_subprocess import render_html_in_subprocess
from drivers.errors import VolcalError

log = structlog.get_logger()

REPORT = "report.html"


def no_report_yet(directory: Path, run_id: str) -> Mapping[str, str | bytes]:
    """Return no files. This function takes the place of the function that renders the report (`ReportRenderer`) in a
    run whose report is rendered only after its end."""
    return {}


class ReportQueue:
    """Queue of reports, which a background thread renders. If the service stops before a report is rendered, the report
    is rendered when it is next requested."""

    def __init__(
        self, directory: Path, make: Callable[[Path, str], Mapping[str, str | bytes]] = render_html_in_subprocess
    ) -> None:
        self._directory = directory
        self._make = make
        self._making = threading.Lock()
        self._asking = threading.Lock()
        self._outdated: set[str] = set()
        self._queue: SimpleQueue[str | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._closed = False

    def request(self, run_id: str) -> None:
        """Queue the report of a run that has ended, and return at once.

        An older report, written before the run was resumed, is removed first. Otherwise the older report would be taken
        for the current one if this process ended now.
        """
        with self._asking:
            self._outdated.add(run_id)
            self._remove(self._directory / run_id / REPORT)
            if self._closed:
                return
            self._queue.put(run_id)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="reports", daemon=True)
                self._thread.start()

    def path(self, run_id: str) -> Path:
        """Return the path of the report of a run. If the report is missing or outdated, render it first.

        Raise the errors of the function that renders the report; by default this function is
        `render_html_in_subprocess`.
        """
        path = self._directory / run_id / REPORT
        with self._making:
            if run_id in self._outdated or not path.is_file():
                self._outdated.discard(run_id)  # before rendering: the run may end again meanwhile
                try:
                    write_all_atomically(path.parent, self._make(self._directory, run_id))
                except BaseException:
                    self._outdated.add(run_id)
                    raise
        return path

    def close(self, within_s: float) -> bool:
        """Start no further report, and wait at most `within_s` for the report in progress. Return True if no report is
        in progress any longer."""
        with self._asking:
            self._closed = True
            self._queue.put(None)
            thread = self._thread
        if thread is not None:
            thread.join(within_s)
        return thread is None or not thread.is_alive()

    def _remove(self, old: Path) -> None:
        try:
            old.unlink(missing_ok=True)
        except OSError as error:
            log.warning("outdated report could not be removed", path=str(old), reason=str(error))

    def _work(self) -> None:
        while (run_id := self._queue.get()) is not None and not self._closed:
            try:
                self.path(run_id)
            except VolcalError as error:
                log.warning("report not rendered", run_id=run_id, reason=str(error))
