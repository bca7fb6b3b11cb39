"""Trial of a run with write-back whose process is killed at many points. The output ends with one line of JSON.

    python -m campaigns.crash_points [--every 1] [--every-other 1] [--seed 1] [--workers 2]
    python -m campaigns.crash_points --kind processes [--kills 500] [--seed 1]

With `--kind processes`, the command `volcal serve` and the simulated machine are processes that reach each other over
TCP, and die by SIGKILL. The service dies before or after a commit of its journal or a write to the controller, in
calibrations, in restorations of a table, and while it starts again; the machine dies before or after it begins, takes
a block of, commits, arms or activates a table, and has lost its activation after every other kill. The command then
starts the service again; the end of the run is acknowledged, and the run is resumed, or given up, by a request or by
`volcal resume` beside the service.

With `--kind run`, which is the default, the run consists of probe check, qualification, measuring, identification,
staging, activation and verification, with the table of an earlier run active. Its journal is a file. In the first run
the new table is accepted; the second one is aborted while it verifies the new table, so that the former one is
restored. Crash points are before and after each commit of the journal, before and after each command to the controller
or the mount, and in the middle of each motion. At each point the process is forked, and the run in the copy ends there.
After some seconds of machine time volcal is started again, or the run is resumed, or it is given up; then it is judged
by the invariants of `campaigns.faults`.

`--every K` selects one point in K while the run measures, and `--every-other K` one in K of the others, at random.
`python -m campaigns.sum` sums the output of calls with different seeds. The exit code is 0 only if no invariant is
violated.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from benchmarks.places import memory_directory
from campaigns.crash_points.crash_recorder import PointSelection
from campaigns.crash_points.killed_runs import ACCEPTED, RUNS, play_run
from campaigns.crash_points.process_kills import ProcessKill, ProcessKills, play_processes
from campaigns.crash_points.process_kills import violations as process_violations
from campaigns.faults.invariants import INVARIANTS, violations
from campaigns.faults.night_record import NightRecord


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=("run", "processes"), default="run", help="what is killed")
    parser.add_argument("--kills", type=int, default=500, help="number of kills of processes")
    parser.add_argument("--wall-minutes", type=float, default=float("inf"), help="longest duration of such kills")
    parser.add_argument("--every", type=int, default=1, metavar="K", help="kill at one point in K while it measures")
    parser.add_argument("--every-other", type=int, default=1, metavar="K", help="kill at one other point in K")
    parser.add_argument("--only-accepted", action="store_true", help="leave out the run that is aborted")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    given = parser.parse_args(arguments)
    began = perf_counter()
    if given.kind == "processes":
        result = kill_processes(given.seed, given.kills, given.wall_minutes)
        print(
            json.dumps(
                {**result, "seed": given.seed, "wall_seconds": round(perf_counter() - began, 1)}, allow_nan=False
            )
        )
        return 0 if result["passed"] else 1
    selections = [
        PointSelection(given.seed, given.every, given.every_other, share, given.workers)
        for share in range(given.workers)
    ]
    runs = [ACCEPTED] if given.only_accepted else RUNS
    asked = [(selection, run) for run in runs for selection in selections]
    counted: Counter[str] = Counter()
    records: list[tuple[str, NightRecord]] = []
    cpu_s = 0.0
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        played = pool.map(play_run, *zip(*asked, strict=True))
        for (selection, _), (points, found, used_s) in zip(asked, played, strict=True):
            counted.update(points if selection.share == 0 else {})
            records += found
            cpu_s += used_s
            for _, record in found:
                if wrong := violations(record):
                    print(json.dumps({**asdict(record), "violated": wrong}, default=str), flush=True)
    result = summarise(counted, records)
    result |= {"seed": given.seed, "cpu_s": round(cpu_s, 1), "wall_seconds": round(perf_counter() - began, 1)}
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def kill_processes(seed: int, kills: int, minutes: float) -> dict[str, Any]:
    """Kill the service and the machine so often, or for so many minutes, and return the totals."""

    def notice(kill: ProcessKill) -> None:
        print(json.dumps(asdict(kill)), flush=True)

    with memory_directory("crash-processes") as name:
        return summarise_processes(play_processes(Path(name), seed, kills, minutes, notice))


def summarise_processes(found: ProcessKills) -> dict[str, Any]:
    """Return the totals of kills of processes."""
    violated = process_violations(found.kills)
    kinds = Counter(f"{one.victim}, {one.point.split(':')[0]}" for one in found.kills)
    return {
        "passed": bool(found.kills) and not any(violated.values()),
        "kills": len(found.kills),
        "kills_by_kind": dict(sorted(kinds.items())),
        "kills_by_work": dict(Counter(f"{one.victim}, {one.doing}" for one in found.kills)),
        "resumed": found.resumed,
        "given_up": found.given_up,
        "accepted": found.accepted,
        "left_to_a_person": found.left_to_a_person,
        "violations": dict(violated),
    }


def summarise(counted: Counter[str], records: Sequence[tuple[str, NightRecord]]) -> dict[str, Any]:
    """Return the totals: points by kind, kills by kind of point, ends, and the violations of each invariant."""
    violated = Counter(name for _, record in records for name in violations(record))
    resumed = [record for _, record in records if record.later is not None]
    return {
        "passed": bool(records) and not violated,
        "points": sum(counted.values()),
        "points_by_kind": dict(counted),
        "kills": len(records),
        "kills_by_kind": dict(sorted(Counter(point for point, _ in records).items())),
        "resumed": len(resumed),
        "resumed_to": dict(sorted(Counter(record.last.state for record in resumed).items())),
        "resumed_and_accepted": sum(record.last.accepted for record in resumed),
        "resumption_refused": sum(bool(record.last.resume_refused) for _, record in records),
        "unproved_at_the_kill": sum(record.active != record.former and not record.accepted for _, record in records),
        "violations": {name: violated[name] for name in INVARIANTS},
    }


if __name__ == "__main__":
    sys.exit(main())
