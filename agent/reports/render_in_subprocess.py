"""A report made in a process of its own: what drawing needs of memory is gone with it, and a machine that is being
measured on is not kept waiting while it draws.

``python -m agent.reports.render_in_subprocess STATE_DIRECTORY RUN_ID INTO [--pdf]`` is that process.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from agent.files import write_all_atomically
from drivers.errors import InputError, VolcalError

TIMEOUT_S = 300.0
EXIT_REPORTED = 2
"""Exit code where the process says in one line what is wrong with the run."""
HINT = "`volcal report` makes it"
TEXT_SUFFIXES = frozenset({".html"})


def render_in_subprocess(directory: Path, run_id: str, *, pdf: bool) -> dict[str, str | bytes]:
    """As `agent.reports.render_from_journal.render_from_journal`."""
    with tempfile.TemporaryDirectory(prefix="volcal-report-") as folder:
        command = [sys.executable, "-P", "-m", "agent.reports.render_in_subprocess", str(directory), run_id, folder]
        _run([*command, "--pdf"] if pdf else command, run_id)
        return {path.name: _read(path) for path in sorted(Path(folder).iterdir())}


def render_html_in_subprocess(directory: Path, run_id: str) -> dict[str, str | bytes]:
    """`agent.reports.renderer.ReportRenderer` of a service."""
    return render_in_subprocess(directory, run_id, pdf=False)


def _run(command: Sequence[str], run_id: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)  # noqa: S603
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"the report of run {run_id} was not made: {error}", hint=HINT) from error
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["it was ended"])[-1]
        text = said if done.returncode == EXIT_REPORTED else f"the report of run {run_id} was not made: {said}"
        raise InputError(text, hint=HINT)


def _read(path: Path) -> str | bytes:
    return path.read_text(encoding="utf-8") if path.suffix in TEXT_SUFFIXES else path.read_bytes()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", type=Path)
    parser.add_argument("run_id")
    parser.add_argument("into", type=Path)
    parser.add_argument("--pdf", action="store_true")
    chosen = parser.parse_args(arguments)
    from agent.reports.render_from_journal import render_from_journal  # noqa: PLC0415  who only starts this process must not load it

    try:
        write_all_atomically(chosen.into, render_from_journal(chosen.directory, chosen.run_id, pdf=chosen.pdf))
    except VolcalError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_REPORTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
