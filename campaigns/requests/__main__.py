"""Random requests to the owner of the machine at all moments of real runs in virtual time. The output ends with one
line of JSON.

    python -m campaigns.requests [--steps 100000] [--seed 1] [--wall-minutes M]

Each trial has a simulated machine and a state directory of its own. A step is a request (start of any kind, hold,
resume, abort, reset, answer, restoration of a table, resumption of a run, reload, end and restart of the service), a
fault or repair of the link, or the passing of machine time. After each step these conditions are checked: at most one
run is in progress; every state follows by an allowed transition; a request is accepted exactly if the status offered
it; a refusal changes neither state nor axes nor table; no touch begins after an abort and no axis moves after an end;
the active table is the former or a proved one; each end is stated; the journal agrees with the status.

`--wall-minutes` ends the campaign earlier; the number of steps is in the output. The exit code is 0 only if no
condition was violated.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import structlog
from numpy.random import Generator

from campaigns.requests.trial import ACTIONS, Count, RequestTrial

STEPS_PER_TRIAL = 500
RARE = {"abort": 0.25, "end_service": 0.15, "cut_or_connect": 0.4, "go_to_the_next_state": 0.25, "reload": 0.3}
"""Weights of the actions that are chosen less often than the others. Runs would else hardly come beyond their first
touches."""
FREQUENT = {"go_on": 4.0, "resume": 2.0, "start": 0.6, "restore_table": 0.2}
MAX_LISTED = 20
S_PER_MIN = 60.0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="number of steps")
    parser.add_argument("--seed", type=int, default=1, help="number from which everything is drawn")
    parser.add_argument("--wall-minutes", type=float, default=float("inf"), help="longest duration in min")
    given = parser.parse_args(arguments)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    count, began, trial = Count(), perf_counter(), 0
    while count.steps.total() < given.steps and perf_counter() - began < given.wall_minutes * S_PER_MIN:
        steps = min(STEPS_PER_TRIAL, given.steps - count.steps.total())
        play(np.random.default_rng([given.seed, trial]), steps, count)
        trial += 1
    result = {"steps": count.steps.total(), "trials": trial, "seed": given.seed, **summarise(count)}
    passed = not count.violations
    print(json.dumps({"passed": passed, **result, "wall_seconds": round(perf_counter() - began, 1)}))
    return 0 if passed else 1


def play(rng: Generator, steps: int, count: Count) -> None:
    """Carry out one trial of so many steps, and add what happened to `count`."""
    names = list(ACTIONS)
    weights = np.array([{**RARE, **FREQUENT}.get(name, 1.0) for name in names])
    with tempfile.TemporaryDirectory(prefix="volcal-requests-") as directory:
        trial = RequestTrial(Path(directory), count)
        try:
            for _ in range(steps):
                trial.perform(str(rng.choice(names, p=weights / weights.sum())), lambda n: int(rng.integers(n)))
        finally:
            trial.close()


def summarise(count: Count) -> dict[str, object]:
    """Return the counts as a JSON object."""

    def listed(counter: Counter[str]) -> dict[str, int]:
        return dict(sorted(counter.items()))

    return {
        "by_request": listed(count.steps),
        "refusals": listed(count.refusals),
        "by_state": listed(count.states),
        "runs_by_end": listed(count.ends),
        "violations": len(count.violations),
        "violated": count.violations[:MAX_LISTED],
    }


if __name__ == "__main__":
    sys.exit(main())
