"""Trial of random plans on a simulated machine with errors. The output ends with one line of JSON.

    python -m campaigns.plans --count 10000 --seed 1 --workers 2
    python -m campaigns.plans --only 123        # repeat one plan and print its result

Each plan is drawn with its own seed. The machine (direction of the spindle, kinematic chain and size), probe, artefact,
mount, stations, positions, procedure and errors are all random. The plan is checked by a preflight in every branch and
run along a random one of them: the table is written and accepted, restored or kept, or the run is refused. The
journaled steps must be those of this branch. Then it is run again with an abort, a hold or an emergency stop at a
random instant.

The first run of every K-th plan is also examined by an independent collision check
(`campaigns/plans/collision_check.py`), where K is given by `--judge-every`. This check is itself compared with the
simulator on random straight moves among the bodies on the table. The exit code is 0 only if there was no collision or
other failure, and if the check always agreed with the simulator.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from time import perf_counter

from campaigns.plans.collision_check_trial import JudgeComparison, compare_judge
from campaigns.plans.trial import PlanTrial, summarise, try_plan

SEED_STRIDE = 1_000_000
MOVES_A_CASE = 20
REPORT_EVERY = 500


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first plan")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--judge-every", type=int, default=20)
    parser.add_argument("--only", type=int, help="seed of one plan, as the JSON line names it")
    given = parser.parse_args(arguments)
    if given.only is not None:
        return _one(given.only)
    began = perf_counter()
    seeds = [given.seed * SEED_STRIDE + number for number in range(given.first, given.first + given.count)]
    trials, compared = _all(seeds, given.judge_every, given.workers)
    wall_s = perf_counter() - began
    result = judged(trials, compared) | {
        "seed": given.seed,
        "first": given.first,
        "wall_seconds": round(wall_s, 1),
        "plans_per_second": round(len(trials) / wall_s, 2),
    }
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1


def judged(trials: Sequence[PlanTrial], compared: JudgeComparison) -> dict[str, object]:
    """Return the totals of the trials and of the comparison of the collision check with the simulator, and whether
    nothing was wrong."""
    totals = summarise(trials)
    return {
        "passed": not totals["failed_seeds"] and not compared.disagreed,
        **totals,
        "judge_compared": compared.moves,
        "judge_collisions": compared.collisions,
        "judge_disagrees": list(compared.disagreed),
    }


def _all(seeds: Sequence[int], judge_every: int, workers: int) -> tuple[list[PlanTrial], JudgeComparison]:
    with ProcessPoolExecutor(workers) as pool:
        examined = frozenset(seeds[::judge_every])
        comparisons = pool.map(partial(compare_judge, moves=MOVES_A_CASE), sorted(examined), chunksize=4)
        trials = []
        for trial in pool.map(partial(_try_plan, examined=examined), seeds, chunksize=8):
            trials.append(trial)
            _report(trial, len(trials))
        return trials, JudgeComparison.sum(comparisons)


def _try_plan(seed: int, examined: frozenset[int]) -> PlanTrial:
    return try_plan(seed, judged=seed in examined)


def _report(trial: PlanTrial, count: int) -> None:
    for failure in trial.failures:
        print(f"seed {trial.seed}: {failure}", flush=True)
    if count % REPORT_EVERY == 0:
        print(f"{count} plans", flush=True)


def _one(seed: int) -> int:
    trial = try_plan(seed, judged=True)
    print(json.dumps({**vars(trial), "seen": None if trial.seen is None else vars(trial.seen)}, default=str))
    return 1 if trial.failures else 0


if __name__ == "__main__":
    sys.exit(main())
