"""Rendering of a report in a subprocess. The memory for drawing is released at the end of the subprocess, and a
measurement that runs at the same time is not delayed.

The subprocess is ``python -m agent.reports.render_in_subprocess STATE_DIRECTORY RUN_ID INTO [--pdf]
[--language LANGUAGE]``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import structlog

from agent.files import write_all_atomically
from agent.language.sentences import LANGUAGES, Language
from drivers.errors import InputError, VolcalError
from drivers.foreign_errors import IN_THE_LOG, cause_of

log = structlog.get_logger()

TIMEOUT_S = 300.0
LAST_LINES = 20
EXIT_REPORTED = 2
"""Exit code if the last line on stderr states the reason for the failure."""
HINT = "render it with `volcal report`"
TEXT_SUFFIXES = frozenset({".html"})


def render_in_subprocess(
    directory: Path, run_id: str, *, pdf: bool, language: Language | None = None
) -> dict[str, str | bytes]:
    """Return the files that `agent.reports.render_from_journal.render_from_journal` returns, but render them in a
    subprocess.

    Raises InputError if the rendering fails.
    """
    with tempfile.TemporaryDirectory(prefix="volcal-report-") as folder:
        command = [sys.executable, "-P", "-m", "agent.reports.render_in_subprocess", str(directory), run_id, folder]
        command += [] if language is None else ["--language", language]
        _run([*command, "--pdf"] if pdf else command, run_id)
        return {path.name: _read(path) for path in sorted(Path(folder).iterdir())}


def render_html_in_subprocess(directory: Path, run_id: str) -> dict[str, str | bytes]:
    """Return the HTML report of a run, rendered in a subprocess. The service uses this function as its
    `ReportRenderer`, the function that renders reports."""
    return render_in_subprocess(directory, run_id, pdf=False)


def _run(command: Sequence[str], run_id: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"the report of run {run_id} could not be rendered: {cause_of(error)}", hint=HINT) from error
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["the process was terminated"]
        if done.returncode == EXIT_REPORTED:
            raise InputError(said[-1], hint=HINT)
        log.error("report not rendered", run_id=run_id, said=said[-LAST_LINES:])
        raise InputError(f"the report of run {run_id} could not be rendered: {IN_THE_LOG}", hint=HINT)


def _read(path: Path) -> str | bytes:
    return path.read_text(encoding="utf-8") if path.suffix in TEXT_SUFFIXES else path.read_bytes()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", type=Path)
    parser.add_argument("run_id")
    parser.add_argument("into", type=Path)
    parser.add_argument("--pdf", action="store_true")
    parser.add_argument("--language", choices=LANGUAGES)
    chosen = parser.parse_args(arguments)
    from agent.reports.render_from_journal import render_from_journal  # noqa: PLC0415  the parent process must not load it

    try:
        files = render_from_journal(chosen.directory, chosen.run_id, pdf=chosen.pdf, language=chosen.language)
        write_all_atomically(chosen.into, files)
    except VolcalError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_REPORTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
