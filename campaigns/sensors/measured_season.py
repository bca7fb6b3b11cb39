"""Seasons of a machine measured ball by ball, without the code of the program: a warm hall moves the machine, and a few
positions of the artefact are measured each night and at hours of the last day."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from campaigns.foreign.artefact import S3, STATIONS_MM, ForeignBar, measure, tilted_bar
from campaigns.foreign.machine import GRID, TOOL, ForeignMachine, foreign_machine
from campaigns.foreign.nights import sloped_machine, walk
from campaigns.foreign.score import family_of, true_error_um
from campaigns.sensors.drifting_machine import SENSOR_SIGMA_K
from campaigns.sensors.hall_climate import BODIES, Array, hall_climate
from campaigns.sensors.table_file import write_rows
from twin.identification import CarriedOverPrior, Estimate, Options, identify, process_noise
from twin.identification.predicted import expected_vce, field_forms
from twin.monitoring.night_fit import compare_with_nights_before
from twin.monitoring.thermal_drift import FusedWith, NightEstimate, ThermalDrift, after_change, explain_thermal_drift

HOURS = (6, 12, 18)
STATES = ("nightly", "temperatures", "positions", "both")
FIRST = 500
_FAMILY = family_of(5)
_NIGHTS, _POSITIONS, _HOURLY, _NIGHT_HOUR = 30, 5, 2, 3
_STATED_UM = 0.5
_COLUMN, _RAM, _BED, _AIR = range(4)


@dataclass(frozen=True, eq=False)
class ThermalMachine:
    """Foreign machine in a hall. `effects` are changes of single errors per K: the error, the change over the travel in
    mm or rad, and the bodies whose temperature raises and lowers it (None: nothing does)."""

    start: ForeignMachine
    effects: tuple[tuple[str, float, int, int | None], ...]
    bodies: Array

    def at(self, hour: int, machine: ForeignMachine) -> ForeignMachine:
        """Return `machine`, as it has walked until then, at the temperatures of this hour."""
        above = self.bodies[hour] - self.bodies[_NIGHT_HOUR]
        for error, per_k, warm, cool in self.effects:
            rise = above[warm] - (0.0 if cool is None else above[cool])
            machine = sloped_machine(machine, error, per_k * rise)
        return machine


def thermal_machine(rng: np.random.Generator, days: int) -> ThermalMachine:
    """Draw a machine and the temperatures of so many days."""
    climate = hall_climate(rng, days)
    effects: tuple[tuple[str, float, int, int | None], ...] = (
        ("EXX", 4.0e-3 * rng.uniform(0.5, 3.0), _BED, None),
        ("EYY", 1.3e-3 * rng.uniform(0.5, 6.0), _RAM, None),
        ("EZZ", 1.5e-3 * rng.uniform(0.5, 6.0), _COLUMN, None),
        ("A0Z", rng.normal(0.0, 2.0e-6), _COLUMN, _BED),
        ("C0Y", rng.normal(0.0, 2.0e-6), _RAM, _COLUMN),
        ("EAX", rng.normal(0.0, 3.0e-6), _AIR, _BED),
    )
    return ThermalMachine(foreign_machine(rng), effects, climate.bodies)


@dataclass(frozen=True, eq=False)
class MeasuredSeason:
    """Season with its nightly estimates, of which each one after the first is fused with those before.

    `readings_c` (h, 4) are those of the sensors in each hour. `walked` is the machine as it has walked until the last
    night, at the temperatures of the first one.
    """

    thermal: ThermalMachine
    bar: ForeignBar
    readings_c: Array
    estimates: tuple[Estimate, ...]
    nights: tuple[NightEstimate, ...]
    walked: ForeignMachine

    @staticmethod
    def hour_of(night: int) -> int:
        return 24 * night + _NIGHT_HOUR

    @property
    def last_hour(self) -> int:
        return self.hour_of(len(self.estimates) - 1)

    def machine_at(self, hours: int) -> ForeignMachine:
        """Return the true machine so many hours after the last night."""
        return self.thermal.at(self.last_hour + hours, self.walked)


def measured_season(number: int, count: int = _NIGHTS) -> MeasuredSeason:
    """Measure and fuse the nights of season `number`."""
    rng = np.random.default_rng([23, number])
    thermal, bar = thermal_machine(rng, count + 1), tilted_bar(rng)
    readings = thermal.bodies + rng.normal(0.0, SENSOR_SIGMA_K, thermal.bodies.shape)
    walked, drift = thermal.start, np.random.default_rng([29, number])
    estimates: list[Estimate] = []
    nights: list[NightEstimate] = []
    for night in range(count):
        walked = walk(walked, night, drift) if night % 3 == 0 else walked
        hour = MeasuredSeason.hour_of(night)
        before = estimates[-1] if estimates else None
        estimate, fused = _measured_night(thermal.at(hour, walked), bar, night, rng, before)
        estimates.append(estimate)
        sigmas = np.full(len(BODIES), SENSOR_SIGMA_K)
        nights.append(
            NightEstimate(float(night), estimate.parameters, estimate.covariance, readings[hour], sigmas, fused)
        )
    return MeasuredSeason(thermal, bar, readings, tuple(estimates), tuple(nights), walked)


@dataclass(frozen=True)
class HourScore:
    """True and predicted error in µm that is left by the estimate of each of `STATES` at an hour of the day."""

    hour: int
    true_um: tuple[float, ...]
    predicted_um: tuple[float, ...]


@dataclass(frozen=True)
class SeasonScore:
    """One season: the sensors that explain its drift, and what was left at the hours after the last night."""

    number: int
    taken: tuple[str, ...]
    hours: tuple[HourScore, ...]


def scored_season(number: int, count: int = _NIGHTS) -> SeasonScore:
    """Explain the nights of season `number`, and estimate the machine at hours of the last day."""
    season, rng = measured_season(number, count), np.random.default_rng([31, number])
    found = explain_thermal_drift(season.nights, BODIES, np.diag(_FAMILY.prior_standard_deviation**2))
    estimate, last, readings = season.estimates[-1], season.last_hour, season.readings_c
    hours = []
    for later in HOURS:
        moved = _moved(found, estimate, readings[last], readings[last + later], later)
        hours.append(_hour_score(later, season.machine_at(later), season.bar, rng, estimate, moved))
    return SeasonScore(number, found.taken, tuple(hours))


def _measured_night(
    machine: ForeignMachine, bar: ForeignBar, night: int, rng: np.random.Generator, before: Estimate | None
) -> tuple[Estimate, FusedWith | None]:
    """Return the estimate of a night: the first from all stations, the others from five positions and those before."""
    if before is None:
        return identify(_FAMILY.model, measure(machine, bar, S3, rng).seen, bar.artefact, _FAMILY), None
    orientations = [S3[(night + number) % len(S3)] for number in range(_POSITIONS)]
    seen = measure(machine, bar, orientations, rng, stations=[STATIONS_MM[night % len(STATIONS_MM)]]).seen
    noise = process_noise(_FAMILY, 1e-3 * _STATED_UM, TOOL)
    prior = compare_with_nights_before(_FAMILY, seen, bar.artefact, before.carried_over(), noise).prior
    own, unknowns = prior.unknowns.blocks.parameters, prior.unknowns
    fused = FusedWith(unknowns.parameters(prior.mean), unknowns.physical_covariance(prior.covariance[own, own]))
    return identify(_FAMILY.model, seen, bar.artefact, _FAMILY, Options(carried_over=prior)), fused


def _moved(found: ThermalDrift, estimate: Estimate, from_c: Array, to_c: Array, hours: int) -> CarriedOverPrior:
    places = [BODIES.index(name) for name in found.sensors]
    sigmas = 2.0**0.5 * SENSOR_SIGMA_K
    change, covariance = found.change(from_c[places], to_c[places], hours / 24.0, sigmas)
    return after_change(estimate.carried_over(), change, covariance)


def _hour_score(
    hour: int,
    machine: ForeignMachine,
    bar: ForeignBar,
    rng: np.random.Generator,
    estimate: Estimate,
    moved: CarriedOverPrior,
) -> HourScore:
    """Return what is left at this hour by the nightly estimate, moved by temperatures, and each with two positions."""
    orientations = [S3[(hour + number) % len(S3)] for number in range(_HOURLY)]
    seen = measure(machine, bar, orientations, rng, stations=[STATIONS_MM[(hour // 6) % len(STATIONS_MM)]]).seen
    aged = estimate.carried_over().after(process_noise(_FAMILY, 1e-3 * _STATED_UM, TOOL), 1.0)
    with_positions = [
        identify(_FAMILY.model, seen, bar.artefact, _FAMILY, Options(carried_over=prior)) for prior in (aged, moved)
    ]
    own, unknowns = moved.unknowns.blocks.parameters, moved.unknowns
    shifted = replace(
        estimate,
        parameters=unknowns.parameters(moved.mean),
        covariance=unknowns.physical_covariance(moved.covariance[own, own]),
    )
    states = (estimate, shifted, *with_positions)
    true = tuple(true_error_um(machine, one) for one in states)
    predicted = tuple(expected_vce(one, field_forms(one, GRID, TOOL)).aligned_um for one in states)
    return HourScore(hour, true, predicted)


def summary(seasons: Sequence[SeasonScore]) -> dict[str, Any]:
    """Return the rms over the seasons of true and predicted errors in µm, by hour and state."""
    hours: dict[str, Any] = {}
    for at, hour in enumerate(HOURS):
        true, stated = (
            np.array([getattr(one.hours[at], name) for one in seasons]) for name in ("true_um", "predicted_um")
        )
        hours[str(hour)] = {
            name: [round(float(np.sqrt(np.mean(values[:, place] ** 2))), 2) for values in (true, stated)]
            for place, name in enumerate(STATES)
        }
    taken = [len(one.taken) > 0 for one in seasons]
    return {"seasons": len(seasons), "taken_percent": round(100.0 * float(np.mean(taken)), 1), "true_stated_um": hours}


def main(arguments: Sequence[str] | None = None) -> int:
    """Score seasons, and print the errors at hours of the day as one line of JSON."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.sensors.measured_season", description=__doc__)
    parser.add_argument("--seasons", type=int, default=20)
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first season")
    parser.add_argument("--csv", type=Path, help="file for one row per season and hour")
    parser.add_argument("--workers", type=int, help="processes; as many as processors if not given")
    asked = parser.parse_args(arguments)
    with ProcessPoolExecutor(asked.workers) as workers:
        found = list(workers.map(scored_season, range(asked.first, asked.first + asked.seasons)))
    if asked.csv is not None:
        write_rows(asked.csv, [row for one in found for row in rows_of_season(one)])
    print(json.dumps(summary(found)))
    return 0


def rows_of_season(one: SeasonScore) -> list[dict[str, str]]:
    """Return the rows of a season in the table of the documents, one per hour."""
    return [
        {"season": str(one.number), "taken": " ".join(one.taken), "hour": str(score.hour)}
        | {f"true_{name}_um": f"{value:.5g}" for name, value in zip(STATES, score.true_um, strict=True)}
        | {f"stated_{name}_um": f"{value:.5g}" for name, value in zip(STATES, score.predicted_um, strict=True)}
        for score in one.hours
    ]


def seasons_of(rows: Sequence[Mapping[str, str]]) -> list[SeasonScore]:
    """Return the seasons of such rows."""
    found: dict[int, SeasonScore] = {}
    for row in rows:
        number = int(row["season"])
        true, stated = (tuple(float(row[f"{kind}_{name}_um"]) for name in STATES) for kind in ("true", "stated"))
        before = found.get(number, SeasonScore(number, tuple(row["taken"].split()), ()))
        found[number] = replace(before, hours=(*before.hours, HourScore(int(row["hour"]), true, stated)))
    return list(found.values())


if __name__ == "__main__":
    raise SystemExit(main())
