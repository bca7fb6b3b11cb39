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
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import structlog
from numpy.random import Generator
from numpy.typing import NDArray

from campaigns.requests.trial import ACTIONS, Count, RequestTrial

STEPS_PER_TRIAL = 500
AT_REST = {"start": 2.0, "end_service": 0.2, "cut_or_connect": 0.4, "go_on": 0.1, "go_to_the_next_state": 0.1}
"""Weights of the actions while no run is in progress, where they are not 1."""
RUNNING = {
    **{"abort": 0.06, "end_service": 0.03, "cut_or_connect": 0.3, "go_on": 2.0, "go_to_the_next_state": 0.15},
    **{"resume": 1.5, "start": 0.2, "restore_table": 0.1},
}
"""Weights while a run is in progress. With more aborts, runs would hardly come beyond their first touches."""
CLOSED = {"end_service": 5.0, "go_on": 0.1, "go_to_the_next_state": 0.1}
"""Weights while the service is closed and no run is in progress: it starts again soon."""
NAMES = list(ACTIONS)
MAX_LISTED = 20
S_PER_MIN = 60.0


def shares_of(weights: Mapping[str, float]) -> NDArray[np.float64]:
    """Return the probability of each of `NAMES`, an array of their number; the weight of a name that is not among
    `weights` is 1."""
    drawn = [weights.get(name, 1.0) for name in NAMES]
    return np.array([weight / sum(drawn) for weight in drawn])


AT_REST_SHARES, CLOSED_SHARES, RUNNING_SHARES = shares_of(AT_REST), shares_of(CLOSED), shares_of(RUNNING)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="number of steps")
    parser.add_argument("--seed", type=int, default=1, help="number from which everything is drawn")
    parser.add_argument("--wall-minutes", type=float, default=float("inf"), help="longest duration in min")
    given = parser.parse_args(arguments)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    count, began, trial = Count(), perf_counter(), 0
    ends_s = began + given.wall_minutes * S_PER_MIN
    while count.steps.total() < given.steps and perf_counter() < ends_s:
        steps = min(STEPS_PER_TRIAL, given.steps - count.steps.total())
        play(np.random.default_rng([given.seed, trial]), steps, count, ends_s)
        trial += 1
    result = {"steps": count.steps.total(), "trials": trial, "seed": given.seed, **summarise(count)}
    passed = not count.violations and count.steps.total() > 0
    print(json.dumps({"passed": passed, **result, "wall_seconds": round(perf_counter() - began, 1)}))
    return 0 if passed else 1


def play(rng: Generator, steps: int, count: Count, ends_s: float) -> None:
    """Carry out one trial of so many steps, or until `ends_s` of `perf_counter`, and add what happened to `count`."""
    with tempfile.TemporaryDirectory(prefix="volcal-requests-") as directory:
        trial = RequestTrial(Path(directory), count)
        try:
            for _ in range(steps):
                if perf_counter() > ends_s:
                    break
                trial.perform(str(rng.choice(NAMES, p=_shares(trial))), lambda n: int(rng.integers(n)))
        finally:
            trial.close()


def _shares(trial: RequestTrial) -> NDArray[np.float64]:
    if not trial.at_rest:
        return RUNNING_SHARES
    return CLOSED_SHARES if trial.closed else AT_REST_SHARES


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
