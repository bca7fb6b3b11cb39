"""Shared set-up of all tests: one BLAS thread, folders in memory, and property tests that a check repeats exactly.

With `CI` set the examples of hypothesis are derived from the tests alone, so that a check that was green stays green
on the same tree; at a desk they are drawn anew each time, to find what is left. `--hypothesis-profile=long` draws many
more, also for tests that otherwise try a few because each example is a whole plan.
"""

from __future__ import annotations

import os
import signal
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is first imported; see agent/cli/main.py

import pytest
from aloud import NOT_HERE
from hypothesis import HealthCheck, settings

settings.register_profile("desk", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("check", parent=settings.get_profile("desk"), derandomize=True, database=None)
settings.register_profile("quick", parent=settings.get_profile("check"), max_examples=10)
settings.register_profile("long", parent=settings.get_profile("desk"), max_examples=1000)
settings.load_profile("check" if os.environ.get("CI") else "desk")

SLOW = Path(__file__).with_name("slow.txt")
LONG = Path(__file__).with_name("long_files.txt")

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  pytest makes a folder of its own inside
ROOM_BYTES = 4 << 30


def _folders_in_memory() -> bool:
    """Whether the folders of tests can be in memory: there is room for them, and programs built in them can run."""
    if not os.access(SHARED_MEMORY, os.W_OK):
        return False
    found = os.statvfs(SHARED_MEMORY)
    return found.f_bavail * found.f_frsize >= ROOM_BYTES and not found.f_flag & os.ST_NOEXEC


# A run makes 10,000 to 20,000 commits, each of which waits for the disk (2 to 8 ms measured); tests of durability kill
# processes, never the computer. Processes that tests start inherit it.
if "TMPDIR" not in os.environ and _folders_in_memory():
    os.environ["TMPDIR"] = tempfile.tempdir = str(SHARED_MEMORY)

# A shell without job control starts what is put in the background with the keyboard's interrupt ignored, and so would
# everything be that the tests start: those that interrupt would wait without end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of slow.txt, so that `make quick` can leave them out; begin with the files of long_files.txt."""
    listed = set(_entries(SLOW))
    for item in items:
        path = item.path.relative_to(config.rootpath).as_posix()
        function = item.nodeid.partition("[")[0].rpartition("/")[2].partition("::")[2]
        if not listed.isdisjoint((path, f"{path}::{function}")):
            item.add_marker(pytest.mark.slow)
    first = {path: place for place, path in enumerate(_entries(LONG))}
    items.sort(key=lambda item: first.get(item.path.relative_to(config.rootpath).as_posix(), len(first)))


def _entries(listing: Path) -> list[str]:
    return [line for line in listing.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reasons = [str(report.longrepr[2]) for report in terminalreporter.stats.get("skipped", ())]
    loud = [reason for reason in reasons if NOT_HERE in reason]
    if loud:
        terminalreporter.section(f"{NOT_HERE}: {len(loud)}", sep="!", red=True, bold=True)
        for reason in sorted(set(loud)):
            terminalreporter.write_line(
                f"{loud.count(reason)} x {reason.partition(NOT_HERE)[2].lstrip(': ')}", red=True
            )
