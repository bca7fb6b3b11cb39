"""Trial of power cuts at each system call of a process that writes a journal and a file. The output ends with one line
of JSON.

    python -m campaigns.power_cuts [--every 1] [--seed 1] [--synchronous NORMAL] [--ignore journal.sqlite-wal]

The process writes some hundred records and a file of several versions, and acknowledges each of them. strace records
its system calls. They are then applied to a disk that loses what was not synchronised (`volatile_disk`). After each
call the power is cut in three ways: everything is kept (the process was killed), nothing but what was synchronised, or
a part, sector by sector. Then the journal and the file are opened as after a start, and everything that had been
acknowledged must be there, whole. The exit code is 0 only if nothing was lost.

`--synchronous NORMAL` weakens the journal, and `--ignore NAME` leaves the synchronisation of the files or directories
with such names out: the trial must find what they lose.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from time import perf_counter

from benchmarks.places import memory_directory
from campaigns.power_cuts.recorded_calls import Synced, recorded_calls
from campaigns.power_cuts.trial import cut_everywhere

MAX_LISTED = 20


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, metavar="K", help="cut after each K-th call")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--synchronous", default="", help="mode of SQLite that replaces the journal's own")
    parser.add_argument("--ignore", default="", metavar="NAME", help="leave the synchronisation of such paths out")
    given = parser.parse_args(arguments)
    began = perf_counter()
    with tempfile.TemporaryDirectory(prefix="volcal-power-cuts-") as name, memory_directory("power-cuts") as work:
        directory = Path(name) / "disk"
        directory.mkdir()
        command = ["-m", "campaigns.power_cuts.journal_writer", str(directory)]
        if given.synchronous:
            command += ["--synchronous", given.synchronous]
        calls = recorded_calls(directory, command, Path(name) / "calls")
        ignored = {
            call.path for call in calls if isinstance(call, Synced) and fnmatch(Path(call.path).name, given.ignore)
        }
        result = cut_everywhere(calls, directory, Path(work), given.seed, given.every, sorted(ignored))
    passed = bool(result.cuts) and not result.lost
    document = {
        "passed": passed,
        "calls": result.calls,
        "synced": result.synced,
        "acknowledged": result.acknowledged,
        "cuts": dict(result.cuts),
        "lost": len(result.lost),
        "listed": result.lost[:MAX_LISTED],
        "wall_seconds": round(perf_counter() - began, 1),
    }
    print(json.dumps(document, allow_nan=False))
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
