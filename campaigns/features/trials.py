"""Predicted errors of features compared with the true ones, on machines that share no code with the program.

Machines of the two generators of `campaigns.foreign` are drawn, measured in the set S3 at four stations and identified.
On each, features are drawn: distances of six lengths, diameters, positions of holes and flatness of faces, and the
acceptance tests of ISO 230 about a drawn centre. Their true errors are compared with the predicted 95 % intervals,
without and with the compensation table of the estimate. Then each feature gets a tolerance drawn about its uncertainty,
and the statements of conformity are compared with the truth.

    python -m campaigns.features --machines 100 [--generator sines] [--each 20]

The output ends with one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from campaigns.features.true_features import DrawnFeature, Field, draw
from campaigns.features.true_tests import true_figure_mm
from campaigns.foreign.calibrated_machine import calibrated_machine
from campaigns.foreign.machine import TOOL, DrawnMachine
from campaigns.foreign.trials import GENERATORS
from twin.compensation.table import CompensationTable
from twin.identification import Estimate
from twin.workpiece.acceptance import SLOPE_LENGTH_MM, acceptance_tests, axis_line
from twin.workpiece.angles import predict_angles
from twin.workpiece.conformity import Conformity
from twin.workpiece.features import Measure, Tolerance
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import FeatureError, predict_features

_SEED = 12
_TOOL = np.asarray(TOOL, dtype=np.float64)
_RADIUS_MM = 300.0
_AT_ORIGIN = Placement(np.zeros(3))


@dataclass(frozen=True)
class ComparedFeature:
    """True error of one feature in mm, and its predicted error. `table` is True if the table was active.
    `tolerance_mm` is the drawn limit of the error's magnitude for which `error.conformity` is stated."""

    group: str
    table: bool
    true_mm: float
    error: FeatureError
    tolerance_mm: float

    @property
    def held(self) -> bool:
        """True if the 95 % interval contains the true error."""
        return self.error.low_mm <= self.true_mm <= self.error.high_mm

    @property
    def wrongly_accepted(self) -> bool:
        """True if conformity is stated although the true error is outside the tolerance."""
        return self.error.conformity is Conformity.CONFORMS and abs(self.true_mm) > self.tolerance_mm


def one_machine(generator: str, each: int, number: int) -> list[ComparedFeature]:
    """Return the comparisons for machine `number` of a generator."""
    rng = np.random.default_rng([number, _SEED])
    found = calibrated_machine(generator, rng)
    machine, estimate, table = found.machine, found.estimate, found.table
    low, high = np.array(machine.ranges).T
    drawn = [*draw(low + _TOOL, high + _TOOL, each, rng), *_tests(machine.ranges, rng)]
    rows = [row for one in drawn for row in _compared(machine, estimate, table, one, rng)]
    return [*rows, *_angles(machine, estimate)]


def _angles(machine: DrawnMachine, estimate: Estimate) -> list[ComparedFeature]:
    """Return the comparisons of the ranges of the angular error motions. A table does not change them."""
    ranges = estimate.model.ranges_mm
    lines = tuple(axis_line(ranges, np.mean(ranges, axis=1), axis) for axis in range(3))
    rows = []
    for number, one in enumerate(predict_angles(estimate, lines, _TOOL, with_table=False)):
        axis, about = divmod(number, 3)
        true_mm = SLOPE_LENGTH_MM * float(np.ptp(machine.angles(axis, lines[axis][1])[:, about]))
        rows.append(ComparedFeature("ISO 230-1 angle", False, true_mm, one.figure.without_table, 0.0))
    return rows


def _tests(ranges: tuple[tuple[float, float], ...], rng: np.random.Generator) -> list[DrawnFeature]:
    """Return the acceptance tests about a drawn centre."""
    x, y, z = ranges
    low, high = np.array(ranges).T
    centre = rng.uniform(low + _RADIUS_MM, high - _RADIUS_MM)
    return [
        DrawnFeature(f"{test.standard} {test.feature.name.split()[0]}", test.feature, (), partial(true_figure_mm, test))
        for test in acceptance_tests((x, y, z), _TOOL, centre, (_RADIUS_MM,))
    ]


def _compared(
    machine: DrawnMachine, estimate: Estimate, table: CompensationTable, one: DrawnFeature, rng: np.random.Generator
) -> list[ComparedFeature]:
    def displaced(points: np.ndarray) -> np.ndarray:
        return machine.deviation(points - _TOOL)

    def corrected(points: np.ndarray) -> np.ndarray:
        return machine.deviation(points - _TOOL) + table.at(points - _TOOL)

    (plain,) = predict_features(estimate, [one.feature, *one.datum], _AT_ORIGIN, _TOOL, table)
    assert plain.with_table is not None
    fields: list[tuple[bool, Field, FeatureError]] = [
        (False, displaced, plain.without_table),
        (True, corrected, plain.with_table),
    ]
    rows = []
    for active, field, error in fields:
        size = abs(error.expected_mm) + error.expanded_mm * float(rng.uniform(0.0, 2.0))
        signed = one.feature.measure is Measure.SIGNED
        toleranced = replace(one.feature, tolerance=Tolerance(-size if signed else None, size))
        (judged,) = predict_features(estimate, [toleranced, *one.datum], _AT_ORIGIN, _TOOL, table)
        stated = judged.with_table if active else judged.without_table
        assert stated is not None
        rows.append(ComparedFeature(one.group, active, one.true_error(field), stated, size))
    return rows


def summary(rows: Sequence[ComparedFeature]) -> dict[str, float]:
    """Return the shares in per cent of the true errors inside their intervals and of the accepted features that do not
    conform, and the mean figures in µm."""
    accepted = [row for row in rows if row.error.conformity is Conformity.CONFORMS]
    wrong = sum(row.wrongly_accepted for row in accepted)
    return {
        "features": len(rows),
        "held_percent": round(100.0 * float(np.mean([row.held for row in rows])), 1),
        "accepted": len(accepted),
        "wrongly_accepted_percent": round(100.0 * wrong / max(len(accepted), 1), 2),
        "true_rms_um": round(1e3 * float(np.sqrt(np.mean([row.true_mm**2 for row in rows]))), 2),
        "expanded_um": round(1e3 * float(np.mean([row.error.expanded_mm for row in rows])), 2),
    }


def main() -> int:
    """Carry out the trials of the command line."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.features", description="Predict features of workpieces.")
    parser.add_argument("--machines", type=int, default=100, help="machines of each generator")
    parser.add_argument("--generator", choices=tuple(GENERATORS), action="append", help="generator; all if not given")
    parser.add_argument("--each", type=int, default=20, help="features of each kind on a machine")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    given = parser.parse_args()
    result = {}
    for generator in given.generator or GENERATORS:
        with ProcessPoolExecutor(given.workers) as workers:
            work = partial(one_machine, generator, given.each)
            rows = [row for found in workers.map(work, range(given.machines)) for row in found]
        groups = {}
        for group in dict.fromkeys(row.group for row in rows):
            for active in sorted({row.table for row in rows if row.group == group}):
                chosen = [row for row in rows if row.group == group and row.table is active]
                groups[f"{group}, {'with' if active else 'without'} table"] = summary(chosen)
        for name, figures in groups.items():
            print(f"{generator}, {name}: {json.dumps(figures)}", flush=True)
        result[generator] = {"all": summary(rows), **groups}
    print(json.dumps(result))
    return 0
