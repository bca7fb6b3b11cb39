"""Trial of one whole run in copies: each copy is interrupted in one way at one of the steps. The output ends with one
line of JSON.

    python -m campaigns.aborts [--every 1] [--workers 2]

The run consists of probe check, qualification, measuring, identification, staging, activation and verification. It
starts with a compensation table from an earlier run (the former table) active, and it is carried out once in each
worker process. At each step the process is forked once for every kind of interruption, and the forked copy runs to its
end.

The kinds of interruption are: an abort by request, a permanent loss of the link, a single failure of the link, a fault
of the machine, a refused command, a guarded move that trips, a full disk, an operator who declines, and a software
defect. Computations, decisions and changes of the state are steps too. An interruption happens before the step, in the
middle of its motion, or after its effect but before the effect is journaled.

`--every K` selects each K-th step. Steps near those that read, write or activate tables are always selected. The exit
code is 0 only if the former table is active after every interruption. There is one exception: after a permanent loss of
the link the run may instead report that the former table could not be activated again.
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

from campaigns.aborts.case import FORMER_BANK
from campaigns.aborts.interrupted_runs import (
    StepSelection,
    check_refused_and_restored,
    run_interrupted,
    uninterrupted_keys,
)

MAX_LISTED = 20


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="interrupt at each K-th step")
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    given = parser.parse_args(arguments)
    began = perf_counter()
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        ends = pool.submit(check_refused_and_restored)
        keys = pool.submit(uninterrupted_keys).result()
        shares = [StepSelection(share, given.workers, given.every, keys) for share in range(given.workers)]
        left = [one for part in pool.map(run_interrupted, shares) for one in part]
        result = {"steps": len(keys), **summarise(left, keys), **ends.result()}
    result["wall_seconds"] = round(perf_counter() - began, 1)
    passed = not (result["failed"] or result["ends_failed"])
    print(json.dumps({"passed": passed, **result}, allow_nan=False))
    return 0 if passed else 1


def summarise(left: Sequence[dict[str, Any]], keys: Sequence[str]) -> dict[str, Any]:
    """Return the totals over `left`, the results of all interrupted runs, and the list of the runs that failed.

    `keys` are the keys of all steps of the uninterrupted run.

    A run that completed although it was interrupted also counts as failed if a step with an effect on the machine was
    still to come when the interruption happened.
    """
    last_acting = max(place for place, key in enumerate(keys, start=1) if key.endswith("!"))
    failed = [one for one in left if one["failures"] or (one.get("completed") and one["ordinal"] <= last_acting)]
    return {
        "aborts": len(left),
        "steps_looked_at": len({one["ordinal"] for one in left}),
        "by_way": dict(sorted(Counter(one["way"] for one in left).items())),
        "completed_before_noticed": sum(bool(one.get("completed")) for one in left),
        "new_bank_left_and_told": sum(one.get("active", FORMER_BANK) != FORMER_BANK for one in left),
        "failed": len(failed),
        "failures": [{name: one.get(name) for name in ("step", "way", "failures")} for one in failed[:MAX_LISTED]],
    }


if __name__ == "__main__":
    sys.exit(main())
