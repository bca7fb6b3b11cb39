"""Worth of a laser line: expected error and machine time of eight positions of the bar with it, against S3.

On the case study, the best eight of the 24 positions of S3 at four stations are chosen with and without a laser line
along X, and with the lines of all axes. The expected volumetric error after compensation (VCE) is in closed form, with
all uncertainties as stated and machines of the family, after the best rigid motion is removed.

    python -m campaigns.instruments.worth [--set-up-minutes 30]

The minutes of the bar are those of the set alone, with carrying. Those of a laser line are two runs in both directions
with four seconds at each of 20 targets, and the time to set it up, which nobody measured: it is an assumption.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import machine_minutes
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from simulators.instruments.machine_under_test import MachineUnderTest
from simulators.instruments.target_line import TargetLine
from simulators.scenario import AxisBehaviour
from twin.artefact.position_set import Position, parse_position_set
from twin.design.candidates import CandidatePositions, build_candidates
from twin.design.goals import PositionCountGoal
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch
from twin.identification.instruments.kinds import LaserSetUp, Readings, laser_line
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.kinematic_chain import AXES
from twin.machine.volumetric import evaluation_grid

_MARGIN_MM = 50.0
_TARGETS, _RUNS = 20, 2
_SIGMA_MM = 0.3e-3
_SET_UP = LaserSetUp(scale_um_per_m=0.5)
_FEW = 8


@dataclass(frozen=True)
class ComparedProcedure:
    """Procedure with its expected error in µm and its minutes: of the bar, and of the laser without set-up."""

    name: str
    positions: int
    lines: int
    orientations: tuple[tuple[int, float, float], ...]
    expected_ve_um: float
    expected_vce_um: float
    bar_minutes: float
    laser_minutes: float


def planned_line(job: Job, axis: int) -> tuple[InstrumentReadings, float]:
    """Return the planned readings of a laser along an axis through the middle of the travel, and the minutes of its
    runs."""
    ranges = np.array(job.machine.model.ranges_mm)
    start, end = ranges.mean(axis=1), ranges.mean(axis=1)
    start[axis], end[axis] = ranges[axis] + np.array([_MARGIN_MM, -_MARGIN_MM])
    line = TargetLine(start, end, _TARGETS, _RUNS)
    points = start + line.along_mm[:, None] * line.direction
    seen = Readings(f"laser {AXES[axis]}", np.zeros(_TARGETS), np.full(_TARGETS, _SIGMA_MM), job.tool_offset_mm)
    still = MachineUnderTest(lambda path, _: np.zeros_like(path), AxisBehaviour(), lambda _: 20.0, 0.0, 0)
    return laser_line(seen, points, _SET_UP), line.visited_by(still).duration_s / 60.0


def candidates_with(
    job: Job, positions: Sequence[Position], instruments: tuple[InstrumentReadings, ...]
) -> CandidatePositions:
    """Return the positions as candidates of a design that counts on the instruments."""
    options = replace(planning_options(job.settings.temperature), instruments=instruments)
    grid = evaluation_grid(job.machine.model.ranges_mm)
    return build_candidates(job.procedure, positions, job.machine.family, options, grid, job.tool_offset_mm)


def best_few(candidates: CandidatePositions, count: int) -> tuple[int, ...]:
    """Return the `count` candidates with the smallest expected error, whatever time they take."""
    same = MeasuringCosts(np.ones(candidates.count), np.array([one.station for one in candidates.positions]))
    return PositionCountGoal(count).select(ExchangeSearch(candidates, same, min_improvement=0.0))


def procedures(job: Job) -> list[ComparedProcedure]:
    """Return the procedures that are compared."""
    every = parse_position_set("S3", len(job.settings.stations.places_mm or ()) or 4)
    lines = [planned_line(job, axis) for axis in range(3)]
    found = []
    for name, count, used in (
        ("S3", len(every), 0),
        ("S3 and laser X", len(every), 1),
        ("best 8 of S3", _FEW, 0),
        ("best 8 of S3 and laser X", _FEW, 1),
        ("best 8 of S3 and laser X, Y, Z", _FEW, 3),
    ):
        candidates = candidates_with(job, every, tuple(readings for readings, _ in lines[:used]))
        chosen = range(candidates.count) if count == len(every) else best_few(candidates, count)
        places = [candidates.positions[index] for index in sorted(chosen)]
        found.append(
            ComparedProcedure(
                name=name,
                positions=len(places),
                lines=used,
                orientations=tuple((p.station, p.azimuth_deg, p.elevation_deg) for p in places)
                if count == _FEW
                else (),
                expected_ve_um=round(candidates.before.aligned_um, 2),
                expected_vce_um=round(candidates.vce(list(chosen)).aligned_um, 2),
                bar_minutes=round(machine_minutes(job, places).total, 1),
                laser_minutes=round(sum(minutes for _, minutes in lines[:used]), 1),
            )
        )
    return found


def main() -> int:
    """Print the comparison as a table and as one line of JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m campaigns.instruments.worth", description="Compare eight positions and a laser line with S3."
    )
    parser.add_argument("--set-up-minutes", type=float, default=30.0, help="minutes to set a laser line up (assumed)")
    given = parser.parse_args()
    found = procedures(load_case(CASE_STUDY))
    for one in found:
        minutes = one.bar_minutes + one.laser_minutes + given.set_up_minutes * one.lines
        sys.stdout.write(
            f"{one.name}: {one.positions} positions, VE {one.expected_ve_um:.2f} µm, VCE {one.expected_vce_um:.2f} µm; "
            f"{one.bar_minutes:.1f} min of the bar, {one.laser_minutes:.1f} min of laser runs, "
            f"{minutes:.1f} min with {given.set_up_minutes:g} min for each set-up\n"
        )
    sys.stdout.write(json.dumps([asdict(one) for one in found]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
