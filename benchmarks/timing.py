"""Computing time of two ways to predict the machine time of a plan: the cycle-time model and the preflight (simulated
execution).

The cycle-time model assumes an ideal machine, and the preflight simulates the physics. The difference between the two
predicted machine times is reported too.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from time import perf_counter

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import expected_plan, machine_minutes, position_minutes, walk_plan
from agent.runs.kinds.calibrate import calibration_of, preflight_of

REPEATS = 5


def median_s(action: Callable[[], object]) -> float:
    action()
    times = []
    for _ in range(REPEATS):
        start = perf_counter()
        action()
        times.append(perf_counter() - start)
    return statistics.median(times)


def run() -> dict[str, float]:
    job = load_case(CASE_STUDY)
    walk_s = median_s(lambda: walk_plan(job, expected_plan(calibration_of(job))))
    preflight_s = median_s(lambda: preflight_of(job))
    _, steps = walk_plan(job, expected_plan(calibration_of(job)))
    return {
        "positions": float(len(job.positions)),
        "set_ms": median_s(lambda: machine_minutes(job, job.positions)) * 1e3,
        "position_ms": median_s(lambda: position_minutes(job, job.positions[0])) * 1e3,
        "walk_ms": walk_s * 1e3,
        "rehearsal_ms": preflight_s * 1e3,
        "rehearsal_in_walks": preflight_s / walk_s,
        "apart": abs(sum(timed.seconds for timed in steps) / preflight_of(job).machine_seconds - 1.0),
    }


def main() -> None:
    result = run()
    print(f"set of {result['positions']:.0f} positions        {result['set_ms']:8.1f} ms   (at most 300)")
    print(f"one position               {result['position_ms']:8.1f} ms   (at most 10)")
    print(f"whole procedure, walked    {result['walk_ms']:8.1f} ms")
    print(f"preflight of the procedure {result['rehearsal_ms']:8.1f} ms")
    print(f"preflight in walks         {result['rehearsal_in_walks']:8.2f} ×")
    print(f"machine time apart by      {result['apart'] * 100.0:8.4f} %    (at most 1)")


if __name__ == "__main__":
    main()
