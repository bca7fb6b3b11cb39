"""Machine time of a measuring plan with and without optimisation of its paths and measuring order, and CPU time of the
optimisation.

With the option `--json` the output is one line of JSON.
"""

from __future__ import annotations

import json
import sys
from time import process_time

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import expected_plan, walk_plan, without_optimisation
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.runs.kinds.calibrate import calibration_of
from agent.settings.load import load_settings, with_overrides
from twin.units import S_PER_MIN

SETS = ("S3", "S1+S2+S3")


def minutes(job: Job) -> float:
    return sum(timed.seconds for timed in walk_plan(job, expected_plan(calibration_of(job)))[1]) / S_PER_MIN


def run() -> dict[str, float]:
    """Return the machine times and CPU times of all position sets by name. The key of a figure starts with the name of
    its position set.

    The figure `seeking_s` is the CPU time in s for the search for paths. It is the difference between the CPU times of
    two calculations of the plan: the first searches for the paths, and the second does not search again.
    """
    load_case(CASE_STUDY)
    found: dict[str, float] = {}
    for name in SETS:
        job = prepare_job(with_overrides(load_settings(CASE_STUDY), position_set=name), CASE_STUDY.parent)
        began = process_time()
        after = minutes(job)
        sought_s, began = process_time() - began, process_time()
        minutes(job)
        again_s = process_time() - began
        before = minutes(without_optimisation(job))
        found |= {
            f"{name} minutes_as_listed": before,
            f"{name} minutes": after,
            f"{name} share": after / before,
            f"{name} seeking_in_walks": sought_s / again_s,
            f"{name} seeking_s": sought_s - again_s,
        }
    return found


def main() -> None:
    for name, value in run().items():
        print(f"{name:32s} {value:10.3f}")


if __name__ == "__main__":
    if "--json" in sys.argv:
        print(json.dumps({name: round(value, 4) for name, value in run().items()}))
    else:
        main()
