"""One whole run broken off at each step in every way; ends with one line of JSON.

    python -m campaigns.aborts [--every 1] [--workers 2]

The run (probe check, qualification, measuring, identification, staging, activation, verification; a former table
active) is carried out once in each worker. At each step the process is forked, once for every way to break the run off,
and the copy goes to its end: abort by request, link lost for good and once, fault of the machine, a refused command, a
guarded move that trips, the disk full, an operator who says no, a defect of ours; before the step, in the middle of
its motion, or after it has acted and before that was journaled. `--every K`: at each K-th step, and at all steps
around those that read, write or activate tables. Exit code 0 only where the former table acts after every one of them.
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
from campaigns.aborts.running import Thinned, broken_off, closed_and_restored, unbroken

MOST_LISTED = 20


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args(arguments)
    began = perf_counter()
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        ends = pool.submit(closed_and_restored)
        keys = pool.submit(unbroken).result()
        shares = [Thinned(share, given.workers, given.every, keys) for share in range(given.workers)]
        left = [one for part in pool.map(broken_off, shares) for one in part]
        result = {"steps": len(keys), **summed(left, keys), **ends.result()}
    result["wall_seconds"] = round(perf_counter() - began, 1)
    passed = not (result["failed"] or result["ends_failed"])
    print(json.dumps({"passed": passed, **result}, allow_nan=False))
    return 0 if passed else 1


def summed(left: Sequence[dict[str, Any]], keys: Sequence[str]) -> dict[str, Any]:
    """A run may be through before anybody notices only where nothing that acts was left to do."""
    last_acting = max(place for place, key in enumerate(keys, start=1) if key.endswith("!"))
    failed = [one for one in left if one["failures"] or (one.get("completed") and one["ordinal"] <= last_acting)]
    return {
        "aborts": len(left),
        "steps_looked_at": len({one["ordinal"] for one in left}),
        "by_way": dict(sorted(Counter(one["way"] for one in left).items())),
        "completed_before_noticed": sum(bool(one.get("completed")) for one in left),
        "new_bank_left_and_told": sum(one.get("active", FORMER_BANK) != FORMER_BANK for one in left),
        "failed": len(failed),
        "failures": [{name: one.get(name) for name in ("step", "way", "failures")} for one in failed[:MOST_LISTED]],
    }


if __name__ == "__main__":
    sys.exit(main())
