"""Trial of a whole calibration over a serial line, once with a simulated GRBL 1.1 and once with grblHAL. The output
ends with one line of JSON.

    python -m campaigns.grbl [--events 600] [--seed 1] [--workers 2]

The run consists of probe check, qualification, measuring, identification, staging, activation and verification, with
the driver `serial-cnc` and tables in files of banks. The line has 115200 baud and the delay of a USB adapter, the
controller its planner and accelerations. At random instants the process is forked, and the copy is disturbed: abort,
feed hold (with and without release), reset, reboot, limit switch, door, a cable that is unplugged, replugged or
stalled, late, garbled and lost lines, lost bytes.

The exit code is 0 only if in every copy nothing moves when it must not, a stop was sent, no measured touch is missing
in the journal, and the run has ended faulted or aborted with the cause in its reason or has not been disturbed at all;
and if both undisturbed runs have completed and made the machine better.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter
from typing import Any

from campaigns.grbl.disturbed_runs import Trial, run_disturbed

RUN_S = 900.0
"""Approximate duration of the run in s of machine time."""
MAX_LISTED = 20


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--events", type=int, default=600, help="disturbances of both dialects together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    parser.add_argument("--dialect", choices=("grbl", "grblhal"), action="append", help="default: both")
    given = parser.parse_args(arguments)
    began = perf_counter()
    dialects = given.dialect or ["grbl", "grblhal"]
    each = -(-given.events // len(dialects))
    trials = [Trial(dialect, given.seed, RUN_S / each, each) for dialect in dialects]
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        found = dict(zip(dialects, pool.map(run_disturbed, trials), strict=True))
    result = summarise(found)
    result["wall_seconds"] = round(perf_counter() - began, 1)
    better = all((one["true_ve_after_um"] or 1e9) < one["true_ve_before_um"] for one in found.values())
    passed = better and not result["failed"] and result["events"] > 0
    print(json.dumps({"passed": passed, **result}, allow_nan=False))
    return 0 if passed else 1


def summarise(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the totals over all disturbed runs, and the list of those that failed."""
    events = [{**one, "dialect": dialect} for dialect, run in found.items() for one in run["results"]]
    failed = [one for one in events if one["failures"]]
    moving = [one["latency_s"] for one in events if one.get("noticed") and one.get("moving")]
    return {
        "events": len(events),
        "while_moving": sum(bool(one.get("moving")) for one in events),
        "by_kind": dict(sorted(Counter(one["kind"] for one in events).items())),
        "ended": dict(sorted(Counter(str(one.get("state")) for one in events).items())),
        "harmless": sum(one.get("noticed") is False for one in events),
        "longest_until_end_s": max(moving, default=None),
        "runs": {name: {key: value for key, value in run.items() if key != "results"} for name, run in found.items()},
        "failed": len(failed),
        "failures": [
            {key: one.get(key) for key in ("dialect", "kind", "at_s", "failures", "reason")} for one in failed
        ][:MAX_LISTED],
    }


if __name__ == "__main__":
    sys.exit(main())
