"""Statements of the identification about foreign machines, compared with the truth.

Machines are drawn, measured and identified. For each, the true volumetric errors (VE without and VCE with
compensation) are compared with the prediction and with the stated 95 % limits. The field of errors is compared with its
intervals at single points, and at twelve points jointly.

The trials `S3`, `S1+S3` and `S1+S2+S3` measure the positions of these sets at four stations, `designed` the 20
positions of `designed.csv`, which `volcal design --positions 20 --grid-deg 45` chose for the case study with a bar of
11 balls tilted by 8°. `nights` fuses ten nights of five positions with a first full night, while the machine walks.

The machines come from one of two generators that share no code: `mixed` (`campaigns.foreign.machine`) or `sines`
(`campaigns.foreign.sine_machine`). The trial `nights` has machines of the first one only.

    python -m campaigns.foreign --machines 500 [--trial S3] [--generator sines] [--csv foreign.csv]

The output ends with one line of JSON.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from importlib.resources import files
from itertools import groupby
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from benchmarks.places import write_csv
from campaigns.foreign.artefact import S1, S2, S3, STATIONS_MM, measure_at, tilted_bar
from campaigns.foreign.machine import KIND_NAMES, DrawnMachine, foreign_machine
from campaigns.foreign.nights import fused_nights, walk
from campaigns.foreign.score import ComparisonWithTruth, compare_with_truth, family_of
from campaigns.foreign.sine_machine import sine_machine
from twin.identification import identify_by_evidence

SETS: Mapping[str, Sequence[tuple[float, float]]] = {"S3": S3, "S1+S3": S1 + S3, "S1+S2+S3": S1 + S2 + S3}
"""Orientations (azimuth, elevation) in degrees of each set, which are measured at every station."""

TRIALS = (*SETS, "designed", "nights")
GENERATORS: Mapping[str, Callable[[np.random.Generator], DrawnMachine]] = {
    "mixed": foreign_machine,
    "sines": sine_machine,
}
"""Functions that draw a machine, by the name of their generator."""
_NIGHTS = 10
_SEED = 11

Places = Sequence[tuple[Sequence[float], Sequence[tuple[float, float]]]]


def places_of(trial: str) -> Places:
    """Return the stations in mm of a trial, each with its orientations (azimuth, elevation) in degrees."""
    if trial in SETS:
        return [(station, SETS[trial]) for station in STATIONS_MM]
    text = files("campaigns.foreign").joinpath("designed.csv").read_text(encoding="utf-8")
    by_station = groupby(csv.DictReader(text.splitlines()), key=lambda row: int(row["station"]))
    return [
        (STATIONS_MM[number - 1], [(float(row["azimuth_deg"]), float(row["elevation_deg"])) for row in rows])
        for number, rows in by_station
    ]


def one_machine(trial: str, generator: str, number: int) -> tuple[str, ComparisonWithTruth]:
    """Return the kinds of error motions of machine `number` of a generator, and the judgement of its estimate."""
    rng = np.random.default_rng([number, _SEED])
    if trial == "nights":
        *_, last = fused_nights(walk, _NIGHTS, seed=int(rng.integers(2**31)))
        return kinds_of(last.machine), compare_with_truth(last.machine, last.estimate, rng)
    machine, bar = GENERATORS[generator](rng), tilted_bar(rng)
    seen = measure_at(machine, bar, places_of(trial), rng).seen
    return kinds_of(machine), compare_with_truth(machine, identify_by_evidence(family_of, seen, bar.artefact), rng)


def kinds_of(machine: DrawnMachine) -> str:
    """Return the kinds of the error motions of the axes X, Y and Z."""
    return " ".join(machine.motion_kinds)


def summary(judged: Sequence[ComparisonWithTruth]) -> dict[str, float]:
    """Return the means over the machines, and the shares of the true values that the stated limits hold in per cent."""
    ratios = np.array([one.ratio for one in judged])
    shares: dict[str, list[float]] = {
        "ve": [one.ve_held for one in judged],
        "vce": [one.vce_held for one in judged],
        "vce_better_than_limits": [one.vce_rank < 0.025 for one in judged],
        "vce_worse_than_limits": [one.vce_rank > 0.975 for one in judged],
        "field_ball_by_ball": [one.field_held for one in judged],
        "field_jointly": [one.joint_held for one in judged],
    }
    return {
        "machines": len(judged),
        "true_before_um": round(float(np.mean([one.before_um for one in judged])), 2),
        "true_after_um": round(float(np.mean([one.after_um for one in judged])), 2),
        "predicted_um": round(float(np.mean([one.predicted_um for one in judged])), 2),
        "ratio": round(float(ratios.mean()), 3),
        "ratio_sd": round(float(ratios.std()), 3),
        **{f"{name}_percent": round(100.0 * float(np.mean(held)), 1) for name, held in shares.items()},
    }


def run_trial(trial: str, machines: int, generator: str) -> tuple[list[dict[str, object]], dict[str, float]]:
    """Return one row for each machine of a trial, and the summary of the trial."""
    with ProcessPoolExecutor() as workers:
        found = list(workers.map(partial(one_machine, trial, generator), range(machines), chunksize=4))
    rows = [{"trial": trial, "machine": n, "kinds": kinds, **asdict(one)} for n, (kinds, one) in enumerate(found)]
    for kind in KIND_NAMES:
        of_kind = [one for kinds, one in found if kind in kinds.split()]
        if of_kind:
            print(f"{trial}, at least one axis with {kind}: {json.dumps(summary(of_kind))}", flush=True)
    whole = summary([one for _, one in found])
    print(f"{trial}: {json.dumps(whole)}", flush=True)
    return rows, whole


def main() -> int:
    """Carry out the trials of the command line."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.foreign", description="Identify foreign machines.")
    parser.add_argument("--machines", type=int, default=500, help="machines of each trial")
    parser.add_argument("--trial", choices=TRIALS, action="append", help="one of the trials; all if not given")
    parser.add_argument("--generator", choices=tuple(GENERATORS), default="mixed", help="generator of the machines")
    parser.add_argument("--csv", type=Path, help="file for one row for each machine")
    given = parser.parse_args()
    trials = {trial: run_trial(trial, given.machines, given.generator) for trial in given.trial or TRIALS}
    if given.csv is not None:
        write_csv([row for rows, _ in trials.values() for row in rows], given.csv)
    print(json.dumps({trial: whole for trial, (_, whole) in trials.items()}))
    return 0
