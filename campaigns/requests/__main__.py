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
import logging
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np
import structlog
from numpy.random import Generator
from numpy.typing import NDArray

from agent.execution.states import RunState
from agent.service.allowed_requests import RESTORE_FORMER, RESUME_RUN, START
from benchmarks.places import memory_directory
from campaigns.requests.trial import ACTIONS, REQUESTS, Count, RequestTrial

STEPS_PER_TRIAL = 500
LONG_FORM_STEPS = 10_000
"""Number of steps from which each request must have been accepted."""
RARE = {
    "end_service": 0.2,
    "kill": 0.1,
    "cut_or_connect": 0.4,
    "refuse_or_permit": 0.2,
    "read_idle": 0.3,
    "reload": 0.3,
}
"""Weights of events that are not requests, while no run is in progress."""
WAITING = {"go_on": 0.1, "go_to_the_next_state": 0.1}
AT_REST = {**RARE, **WAITING, "start": 2.0}
"""Weights of the actions while no run is in progress, where they are not 1."""
RUNNING = {
    **{"abort": 0.06, "end_service": 0.03, "kill": 0.02, "cut_or_connect": 0.3, "refuse_or_permit": 0.1},
    **{"go_on": 2.0, "go_to_the_next_state": 0.2, "resume": 1.5, "answer": 2.0, "start": 0.2, "restore_table": 0.1},
}
"""Weights while a run is in progress. With more aborts, runs would hardly come beyond their first touches."""
PROVING = {**RUNNING, "abort": 0.2, "kill": 0.3, "refuse_or_permit": 0.6}
"""Weights while a new table is active that is not proved yet: the run often ends there, and cannot restore."""
UNPROVED = {**RARE, **WAITING, "refuse_or_permit": 0.6, "restore_former": 2.0, "give_up": 1.0, "resume_run": 2.0}
"""Weights while no run is in progress and an unproved table is active."""
UNFINISHED = {**RARE, **WAITING, "resume_run": 3.0}
"""Weights while no run is in progress and an unfinished run is offered."""
CLOSED = {**WAITING, "end_service": 5.0}
"""Weights while the service is closed and no run is in progress: it starts again soon."""
NOT_OFFERED = 0.25
"""Factor of the weight of a request that the status does not offer, and that is therefore refused."""
OFFERED_AS = {"restore_table": START}
"""Requests that the status offers under another name. A reload is not offered by it."""
NAMES = list(ACTIONS)
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
    steps = count.steps.total()
    missed = [name for name in REQUESTS if not count.accepted[name]]
    passed = not count.violations and not (missed and steps >= LONG_FORM_STEPS) and steps > 0
    result = {"passed": passed, "steps": steps, "trials": trials, "seed": given.seed, "first": given.first}
    result |= {**summarise(count), "never_accepted": missed, "cpu_s": round(cpu_s, 1)}
    print(json.dumps(result | {"wall_seconds": round(perf_counter() - began, 1)}))
    return 0 if passed else 1


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


def play_trial(seed: int, number: int, steps: int, ends_s: float) -> tuple[Count, float]:
    """Carry out one trial of so many steps, or until `ends_s` of `perf_counter`, which is the same in all processes.
    Return what happened, and the CPU time in s that it took."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began_s, count = process_time(), Count()
    if perf_counter() < ends_s:
        play(np.random.default_rng([seed, number]), steps, count, ends_s)
    return count, process_time() - began_s


def play(rng: Generator, steps: int, count: Count, ends_s: float) -> None:
    """Carry out one trial of so many steps, or until `ends_s` of `perf_counter`, and add what happened to `count`."""
    with memory_directory("requests") as directory:
        trial = RequestTrial(Path(directory), count)
        try:
            for _ in range(steps):
                if perf_counter() > ends_s:
                    break
                trial.perform(str(rng.choice(NAMES, p=_shares(trial))), lambda n: int(rng.integers(n)))
        finally:
            trial.close()


def _shares(trial: RequestTrial) -> NDArray[np.float64]:
    """Return the probability of each of `NAMES`, an array of their number."""
    weights, may = _weights(trial), trial.may

    def weight(name: str) -> float:
        is_offered = name not in REQUESTS or name == "reload" or OFFERED_AS.get(name, name) in may
        return weights.get(name, 1.0) * (1.0 if is_offered else NOT_OFFERED)

    drawn = [weight(name) for name in NAMES]
    return np.array([one / sum(drawn) for one in drawn])


def _weights(trial: RequestTrial) -> Mapping[str, float]:
    if not trial.at_rest:
        return PROVING if trial.state in (RunState.ACTIVATING, RunState.VERIFYING) else RUNNING
    if trial.closed:
        return CLOSED
    if RESTORE_FORMER in trial.may:
        return UNPROVED
    return UNFINISHED if RESUME_RUN in trial.may else AT_REST


def summarise(count: Count) -> dict[str, object]:
    """Return the counts as a JSON object."""

    def listed(counter: Counter[str]) -> dict[str, int]:
        return dict(sorted(counter.items()))

    return {
        "by_action": listed(count.steps),
        "accepted": {name: count.accepted[name] for name in REQUESTS},
        "refusals": listed(count.refusals),
        "by_state": listed(count.states),
        "runs_by_end": listed(count.ends),
        "violations": len(count.violations),
        "violated": count.violations[:MAX_LISTED],
    }


if __name__ == "__main__":
    sys.exit(main())
