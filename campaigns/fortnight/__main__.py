"""Simulated fortnight of the real calibration service with many kinds of incidents. The fortnight produces a run
history.

    python -m campaigns.fortnight [--figure trend.png] [--csv fortnight.csv]

The output ends with one line of JSON. The exit code is 0 only if every claim holds.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

from campaigns.fortnight.play import DAMAGE, FORTNIGHT, SHORT, FortnightResult, run_fortnight


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, help="write the trends as drawn by `volcal history`")
    parser.add_argument("--csv", type=Path, help="write one row per evening")
    parser.add_argument(
        "--thin", action="store_true", help="shortened: all incidents in five evenings, with a small set"
    )
    given = parser.parse_args(arguments)
    played = run_fortnight(SHORT if given.thin else FORTNIGHT, lambda text: print(text, flush=True), given.figure)
    if given.csv is not None:
        write_csv(played, given.csv)
    result = verdict(played)
    print(json.dumps(result))
    return 0 if result["passed"] else 1


def verdict(played: FortnightResult) -> dict[str, object]:
    evenings = played.evenings
    claims = [held for evening in evenings for held in evening.claims.values()] + [*played.claims.values()]
    bounded = [evening for evening in evenings if evening.incident != DAMAGE]
    ratios = {evening.night + 1: round(evening.ratio, 3) for evening in bounded if evening.reach > 0.0}
    told = {name: value for evening in evenings for name, value in evening.figures.items()}
    return {
        "passed": all(claims) and not played.failed,
        "failed": played.failed,
        "claims": len(claims),
        "nights": len(evenings),
        "runs": len(played.rows),
        "ends": [row["state"] for row in played.rows],
        "decisions": [row["night"] for row in played.rows],
        "collisions": played.collisions,
        "worst_ratio": max(ratios.values(), default=None),
        "worst_night": max(ratios, key=ratios.__getitem__, default=None),
        "largest_true_vce_um": round(max(evening.true_after for evening in bounded), 3),
        "damaged_true_vce_um": [round(e.true_after, 3) for e in evenings if e.incident == DAMAGE],
        **told,
        "alarms": {when: [alarm["text"] for alarm in trend["alarms"]] for when, trend in played.trends.items()},
        "cpu_seconds": round(cpu_seconds(), 1),
        "wall_seconds": round(played.wall_s, 1),
    }


def cpu_seconds() -> float:
    """Return the CPU time in s of this process and of all its finished child processes."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def write_csv(played: FortnightResult, path: Path) -> None:
    """Write a CSV file with one row for each evening.

    A row contains columns of the history row of the last run of that evening, and the true errors of the machine, known
    to the simulator.
    """
    names = ("kind", "state", "night", "accepted", "machine_minutes", "ve_now_um", "acting_um", "table_crc32")
    rows = iter(played.rows)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("night", "incident", "station", *names, "true_before", "true_after", "reach", "ratio"))
        for evening in played.evenings:  # each evening has at least one run
            row = [next(rows) for _ in evening.expected][-1]
            truth = (evening.true_before, evening.true_after, evening.reach, evening.ratio)
            head = (evening.night + 1, evening.incident, evening.station)
            writer.writerow((*head, *(row[name] for name in names), *(round(value, 4) for value in truth)))


if __name__ == "__main__":
    sys.exit(main())
