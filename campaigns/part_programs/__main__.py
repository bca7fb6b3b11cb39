"""Trial of `volcal gcode correct` on random part programs, against the interpreter of LinuxCNC (`rs274`). The output
ends with one line of JSON.

    python -m campaigns.part_programs --count 20000 --seed 1 --workers 2
    python -m campaigns.part_programs --only 123        # repeat one program and print it with its result

A program has a dozen blocks with codes of many modal groups in random order: motion, polar coordinates, arcs, canned
cycles, offsets, G92, G28, G53, units, planes, distance modes. Blocks that `rs274` or volcal refuses are taken out. The
original and the corrected program are executed by `rs274` and compared block by block: kind and number of moves, the
path of each (within the chord error of the path that the table asks for), duration, feed mode, spindle and coolant.

The exit code is 0 only if no program failed; 77 if `rs274` is not installed.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import Any

from campaigns.part_programs.comparison import CHORD_MM, ProgramTrial, try_program
from campaigns.part_programs.rs274 import RS274

SEED_STRIDE = 1_000_000
MAX_LISTED = 20
EXIT_NOT_RUN = 77


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first program")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="number of processes")
    parser.add_argument("--only", type=int, help="seed of one program, as the JSON line names it")
    given = parser.parse_args(arguments)
    if RS274 is None:
        print("rs274 is not installed: install the package linuxcnc-uspace", file=sys.stderr)
        return EXIT_NOT_RUN
    if given.only is not None:
        return _one(given.only)
    began = perf_counter()
    seeds = [given.seed * SEED_STRIDE + number for number in range(given.first, given.first + given.count)]
    with ProcessPoolExecutor(given.workers) as pool:
        trials = list(pool.map(try_in_own_folder, seeds, chunksize=20))
    result = {
        **summarise(trials),
        "seed": given.seed,
        "first": given.first,
        "wall_seconds": round(perf_counter() - began, 1),
    }
    passed = not result["failed"] and result["programs"] > 0
    print(json.dumps({"passed": passed, **result}, allow_nan=False))
    return 0 if passed else 1


def try_in_own_folder(seed: int) -> ProgramTrial:
    """Try the program with this seed in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        return try_program(seed, Path(folder))


def summarise(trials: Sequence[ProgramTrial]) -> dict[str, Any]:
    """Return the totals over all programs, and the list of those that failed."""
    failed = [trial for trial in trials if trial.failures]
    reasons = sum((trial.not_supported for trial in trials), Counter[str]())
    return {
        "programs": len(trials),
        "blocks": sum(trial.blocks for trial in trials),
        "moves": sum(trial.moves for trial in trials),
        "largest_deviation_um": round(1e3 * max((trial.deviation_mm for trial in trials), default=0.0), 3),
        "chord_um": 1e3 * CHORD_MM,
        "refused_by_rs274": sum(trial.invalid for trial in trials),
        "refused_by_volcal": dict(reasons.most_common()),
        "failed": len(failed),
        "failures": [{"seed": trial.seed, "failures": trial.failures} for trial in failed[:MAX_LISTED]],
    }


def _one(seed: int) -> int:
    trial = try_in_own_folder(seed)
    print(trial.program)
    print(json.dumps(summarise([trial]), allow_nan=False))
    return 1 if trial.failures else 0


if __name__ == "__main__":
    sys.exit(main())
