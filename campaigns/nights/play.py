"""Trial of nightly calibrations of one machine whose errors drift and that has one collision.

The first night is a full calibration, and each later night has a short time slot. Every night is a whole run of the
agent (`volcal nightly`) on the simulated machine of that night, in this process and on virtual time. The result of a
night includes facts that only the simulator knows: the true volumetric error with the active compensation table, and
the reach. The reach is the error that a full calibration in the same night would have left.

The reach is computed by a Monte Carlo simulation of ball centres, without touches. The simulation takes the true ball
centres of the artefact in the whole position set on a copy of that night's machine. It measures them through the exact
error field with the noise that the touches on a ball cause, and identifies the machine errors with the Legendre order
that the Bayesian evidence selects. Then the true error with the resulting table is evaluated. The reach is the mean
over several random draws of the noise (their number is `DRAWS`). The results of the full calibrations that were run in
the season are reported too.

    python -m campaigns.nights --nights 30 --step 17 [--figure nights.png] [--csv nights.csv]

The output ends with one line of JSON. The exit code is 0 only if every claim holds.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported


from agent.execution.device_assembly import Devices
from agent.execution.rig import Rig
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.results.run_outcome import Decision, Outcome
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.kinds.night_plan import job_at_station
from agent.runs.kinds.nightly import Night
from agent.runs.planned_run import Kind
from agent.runs.run_context import RunHooks
from agent.runs.session import carry_out
from benchmarks.places import memory_directory, write_csv
from campaigns.nights.figure import draw
from campaigns.nights.row import NightRow
from campaigns.nights.season import DRAWS, Season, full_calibration_vce_um, load_season_case, true_vce_with_table
from drivers.clock import Clock, VirtualClock
from drivers.roles import TableImage
from simulators.backend import SimulatedMachineDevice
from simulators.world.ageing import scenario_of_night
from simulators.world.world import World

SLOT_MINUTES = 15.0
FULL_SLOT_MINUTES = 180.0
LARGEST_RATIO = 1.5


def run_season(season: Season, report: bool = True) -> list[NightRow]:
    """Run all nights in order and return one row for each night.

    Meanwhile a separate process computes for each night the true error that a full calibration would have left.
    """
    with (
        ProcessPoolExecutor(1) as pool,
        memory_directory("nights") as directory,
    ):
        reached = [pool.submit(full_calibration_vce_um, season, night) for night in range(season.nights + 1)]
        rows, machine = [], SeasonMachine(season, Path(directory) / "state")
        for night in range(season.nights + 1):
            row = machine.row(night)
            reach = reached[night].result()
            rows.append(replace(row, reach=reach, ratio=row.true_after / reach))
            if report:
                print(_line(rows[-1]), flush=True)
    return rows


class SeasonMachine:
    """One machine and the agent that calibrates it. From night to night the machine's controller retains the
    compensation tables in its memory banks.
    """

    def __init__(self, season: Season, state: Path) -> None:
        self._season = season
        self._scenario = season.scenario
        self._state = state
        self._banks: dict[int, TableImage] = {}
        self._active = 0
        self._first: TableImage | None = None
        self._needs_full = False

    def row(self, night: int) -> NightRow:
        world = self._world(night)
        before = world.truth.true_volumetric_error(self._active)[1]
        outcome = self._run(world, night)
        self._banks, self._active = dict(world.controller.banks), world.controller.active_bank
        if self._first is None:
            self._first = self._banks[self._active]
        found = outcome.night
        self._needs_full = found is not None and found.decision is Decision.FULL_NEEDED
        return NightRow(
            night=night,
            station=self._season.station(night),
            decision="calibrated" if found is None else found.decision.value,
            minutes=outcome.machine_minutes,
            positions=0 if found is None else found.positions,
            true_before=before,
            true_after=world.truth.true_volumetric_error(self._active)[1],
            untouched=true_vce_with_table(world, self._first),
            reach=math.nan,
            ratio=math.nan,
            ve_now=None if found is None else found.ve_now_um,
            ve_after=None if found is None else found.ve_after_um,
            chi2=None if found is None else found.chi2_normalised,
            named="" if found is None else ", ".join(one.text for one in found.jumped),
            reason=outcome.reason or ("" if found is None else found.reason),
        )

    def _world(self, night: int) -> World:
        scenario = scenario_of_night(self._scenario, night)
        settings = scenario.settings.model_copy(update={"standing_at": self._season.station(night)})
        world = World(replace(scenario, settings=settings))
        for bank, image in self._banks.items():
            world.controller.write_bank(bank, image)
        if self._active:
            world.controller.activate(self._active)
        return world

    def _run(self, world: World, night: int) -> Outcome:
        job = job_at_station(load_season_case(self._state), self._season.station(night))
        devices = Devices(lambda _, clock, __: build_rig(world, clock, job), lambda _: VirtualClock())
        hooks = RunHooks(devices=devices, write_files=False)
        ended = carry_out(job, self._kind(night), SHIPPED_CONFIGURATION, hooks)
        if world.collisions:
            raise RuntimeError(f"night {night}: {world.collisions[0]}")
        return ended.outcome

    def _kind(self, night: int) -> Kind:
        if night == 0:
            return FullCalibration(nights=1.0)
        slot = FULL_SLOT_MINUTES if self._needs_full else SLOT_MINUTES
        return Night(slot_minutes=slot, full_allowed=self._needs_full, nights=1.0)


def build_rig(world: World, clock: Clock, job: Job) -> Rig:
    """Return a rig in which one simulated device, in this process, takes the place of every device: machine, probe,
    mounts, table store, thermometer and operator.
    """
    device = SimulatedMachineDevice(world, clock)
    mounts = dict.fromkeys(range(1, len(job.settings.stations.places_mm) + 1), device)
    return Rig(
        devices={"twin": device},
        machine=device,
        probe=device,
        mounts=mounts,
        store=device,
        thermometer=device,
        operator=device,
        clock=clock,
    )


def verdict(season: Season, rows: Sequence[NightRow]) -> dict[str, object]:
    """Return the claims about the nights and the figures on which they are based.

    The value of a claim is True if the claim holds.
    """
    slots = [row for row in rows[1:] if row.night != season.step]
    worst = max(slots, key=lambda row: row.ratio, default=rows[0])
    happens = season.step <= season.nights
    needed = [row.night for row in rows if row.decision == Decision.FULL_NEEDED.value]
    full = [row.night for row in rows if row.decision == Decision.FULL_DONE.value]
    named = rows[season.step].named if happens else ""
    claims = {
        "ratio_within": worst.ratio <= LARGEST_RATIO,
        "short_slots_kept": all(row.minutes <= SLOT_MINUTES for row in slots if row.night not in full),
        "step_noticed_at_next_slot": not happens or needed[:1] == [season.step],
        "step_named": not happens or named.startswith("B0Z"),
        "led_to_full_calibration": not happens or season.step == season.nights or full[:1] == [season.step + 1],
        "no_false_alarm": needed == ([season.step] if happens else []),
    }
    return {
        "passed": all(claims.values()),
        **claims,
        "nights": season.nights,
        "step_night": season.step if happens else None,
        "step_named_as": named,
        "worst_ratio": round(worst.ratio, 3),
        "worst_night": worst.night,
        "largest_true_vce_um": round(max(row.true_after for row in slots or rows), 3),
        "largest_without_nights_um": round(max(row.untouched for row in slots or rows), 3),
        "reach": f"Monte Carlo of ball centres, mean of {DRAWS}",
        "real_full_calibrations_um": {str(rows[n].night): round(rows[n].true_after, 3) for n in (0, *full)},
        "per_night": [
            {
                "night": row.night,
                "decision": row.decision,
                "minutes": round(row.minutes, 2),
                "true_vce_um": round(row.true_after, 3),
                "reach_um": round(row.reach, 3),
                "ratio": round(row.ratio, 3),
            }
            for row in rows
        ],
    }


def _line(row: NightRow) -> str:
    says = "" if row.ve_now is None else f" says {row.ve_now:.2f}"
    chi2 = "" if row.chi2 is None else f" χ² {row.chi2:.2f}"
    return (
        f"{row.night:2d} station {row.station}: {row.decision:24s} {row.minutes:6.2f} min, {row.positions} positions"
        f"{chi2}{says} | true {row.true_before:5.2f} -> {row.true_after:5.2f} µm, full {row.reach:5.2f}, "
        f"ratio {row.ratio:4.2f} {row.named}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nights", type=int, default=30, help="number of nights after the first calibration")
    parser.add_argument("--step", type=int, default=17, help="night of the collision; none if beyond the last night")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args(arguments)
    began = perf_counter()
    season = Season(given.nights, given.step, given.seed)
    rows = run_season(season)
    if given.csv is not None:
        write_csv([asdict(row) for row in rows], given.csv)
    if given.figure is not None:
        draw(rows, season.step, given.figure)
    result = {**verdict(season, rows), "wall_seconds": round(perf_counter() - began, 1)}
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1
