"""Random requests to the owner of the machine at all moments of real runs in virtual time. The output ends with one
line of JSON.

    python -m campaigns.requests [--steps 100000] [--first 0] [--seed 1] [--workers 2] [--wall-minutes M]

Each trial has a simulated machine and a state directory of its own. A step is a request (start of any kind, hold,
resume, abort, reset, answer, restoration of a table, resumption of a run, reload, end and restart of the service), a
fault or repair of the link, or the passing of machine time. After each step these conditions are checked: at most one
run is in progress; every state follows by an allowed transition; a request is accepted exactly if the status offered
it; a refusal changes neither state nor axes nor table; no touch begins after an abort and no axis moves after an end;
the active table is the former or a proved one; each end is stated; the journal agrees with the status.

Each trial has 500 steps. `--first` is the number of the first trial: it goes on with the trials of a seed after earlier
calls, and `python -m campaigns.sum` sums their output. `--wall-minutes` ends the campaign earlier; the number of steps
is in the output. The exit code is 0 only if no condition was violated and, from 10,000 steps on, each request was
accepted.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from time import perf_counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from campaigns.requests.random_steps import play_trial
from campaigns.requests.trial import REQUESTS, Count

STEPS_PER_TRIAL = 500
LONG_FORM_STEPS = 10_000
"""Number of steps from which each request must have been accepted."""
MAX_LISTED = 20
S_PER_MIN = 60.0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="number of steps")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seed", type=int, default=1, help="number from which everything is drawn")
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    parser.add_argument("--wall-minutes", type=float, default=float("inf"), help="longest duration in min")
    given = parser.parse_args(arguments)
    began = perf_counter()
    ends_s = began + given.wall_minutes * S_PER_MIN
    count, trials, cpu_s = Count(), 0, 0.0
    for trial, (played, used_s) in _played(given.seed, given.first, given.steps, ends_s, given.workers):
        for text in played.violations:
            print(f"trial {trial}: {text}", file=sys.stderr, flush=True)
        count.add(played)
        trials += bool(played.steps)
        cpu_s += used_s
    result = summarise(count) | {"trials": trials, "seed": given.seed, "first": given.first, "cpu_s": round(cpu_s, 1)}
    print(json.dumps(result | {"wall_seconds": round(perf_counter() - began, 1)}))
    return 0 if result["passed"] else 1


def _played(
    seed: int, first: int, steps: int, ends_s: float, workers: int
) -> Iterator[tuple[int, tuple[Count, float]]]:
    """Yield the number of each trial with what `play_trial` returns."""
    numbers = range(first, first - (-steps // STEPS_PER_TRIAL))
    sizes = [min(STEPS_PER_TRIAL, steps - STEPS_PER_TRIAL * turn) for turn in range(len(numbers))]
    work = repeat(seed), numbers, sizes, repeat(ends_s)
    if workers == 1:
        yield from zip(numbers, map(play_trial, *work), strict=True)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from zip(numbers, pool.map(play_trial, *work), strict=True)


def summarise(count: Count) -> dict[str, object]:
    """Return the counts as a JSON object, and whether no condition was violated and enough was accepted."""
    steps = count.steps.total()
    missed = [name for name in REQUESTS if not count.accepted[name]]

    def listed(counter: Counter[str]) -> dict[str, int]:
        return dict(sorted(counter.items()))

    return {
        "passed": not count.violations and not (missed and steps >= LONG_FORM_STEPS) and steps > 0,
        "steps": steps,
        "by_action": listed(count.steps),
        "accepted": {name: count.accepted[name] for name in REQUESTS},
        "refusals": listed(count.refusals),
        "by_state": listed(count.states),
        "runs_by_end": listed(count.ends),
        "violations": len(count.violations),
        "violated": count.violations[:MAX_LISTED],
        "never_accepted": missed,
    }


if __name__ == "__main__":
    sys.exit(main())
