"""Sensors that the program takes, and what it predicts with them, judged on machines that share no code with it."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from campaigns.sensors.drifting_machine import (
    ERRORS,
    KINDS,
    SENSOR_SIGMA_K,
    WIDTH_UM,
    DriftingMachine,
    Kind,
    drifting_machine,
)
from campaigns.sensors.hall_climate import Array
from campaigns.sensors.table_file import write_rows
from twin.errors import DataError
from twin.monitoring.thermal_drift import NightEstimate, ThermalDrift, explain_thermal_drift

FIRST = 1000
"""Number of the first machine; those with lower numbers served to try the program."""
HOURS = (6, 12, 18)
"""Hours after the last night at which the prediction is compared with the truth."""
_HELD_BACK = 2  # last nights that are predicted, each from those before
_FACTOR = 1.96


@dataclass(frozen=True)
class JudgedMachine:
    """Judgement of one machine.

    `taken` is the number of sensors that explain its drift, `decoys` how many of them have nothing to do with it, and
    `stuck` how many of them stick. `rms_um` contains for each of `HOURS` the rms over the seen errors of truth minus
    the last night, and of truth minus prediction by the sensors. `inside` and `stated` are the number of predicted
    values inside their 95 % band, and of all of them. `left_out` contains the mean squares in µm² of nights that were
    left out, with and without sensors.
    """

    kind: Kind
    number: int
    refused: str
    nights: int
    taken: int
    decoys: int
    stuck: int
    rms_um: tuple[tuple[float, float], ...]
    inside: int
    stated: int
    left_out: tuple[float, float]


def judged(kind: Kind, number: int) -> JudgedMachine:
    """Judge the machine of this kind and number."""
    machine = drifting_machine(number, kind)
    try:
        found = explained(machine, len(machine.days))
    except DataError as error:
        return JudgedMachine(kind, number, error.message, len(machine.days), 0, 0, 0, (), 0, 0, (0.0, 0.0))
    taken = {machine.sensors.index(name) for name in found.taken}
    rms, inside, stated = _hours_predicted(machine)
    squares = [float(np.mean(one**2)) for one in found.left_out]
    return JudgedMachine(
        kind,
        number,
        "",
        len(machine.days),
        len(taken),
        len(taken & machine.decoys),
        len(taken & machine.stuck),
        rms,
        inside,
        stated,
        (squares[0], squares[1]),
    )


def explained(machine: DriftingMachine, count: int) -> ThermalDrift:
    """Return what the program finds in the first `count` nights."""
    sigmas = np.hypot(SENSOR_SIGMA_K, machine.spans_k / np.sqrt(12.0))
    nights = [
        NightEstimate(
            float(machine.days[at]), machine.estimates[at], machine.covariance, machine.readings_c[at], sigmas[at]
        )
        for at in range(count)
    ]
    return explain_thermal_drift(nights, machine.sensors, WIDTH_UM**2 * np.eye(ERRORS))


def _hours_predicted(machine: DriftingMachine) -> tuple[tuple[tuple[float, float], ...], int, int]:
    """Predict the machine some hours after each of the last nights from what was known then.

    The reference is the true machine of the night, so that the band is that of the change alone: the noise of the
    estimate of the night is stated by its own covariance.
    """
    squares = np.zeros((len(HOURS), 2))
    inside = stated = 0
    for count in range(len(machine.days) - _HELD_BACK, len(machine.days)):
        found = explained(machine, count)
        usable = [machine.sensors.index(name) for name in found.sensors]
        night = round(24.0 * float(machine.days[count - 1]))
        weights = found.directions.analysis
        for row, hours in enumerate(HOURS):
            from_c, to_c = machine.hourly_c[night, usable], machine.hourly_c[night + hours, usable]
            mean, covariance = found.change(from_c, to_c, hours / 24.0, 2.0**0.5 * SENSOR_SIGMA_K)
            really = machine.true[night + hours] - machine.true[night]
            squares[row] += _square(found, really), _square(found, really - mean)
            sigma = np.sqrt(np.einsum("dp,pq,dq->d", weights, covariance, weights))
            away = np.abs(weights @ (really - mean))
            inside += int((away <= _FACTOR * sigma).sum())
            stated += len(sigma)
    rms = np.sqrt(squares / _HELD_BACK)
    return tuple((float(before), float(after)) for before, after in rms), inside, stated


def _square(found: ThermalDrift, change: Array) -> float:
    """Return the mean square in µm² of the part of a change that the measurements see."""
    seen = found.directions.synthesis @ (found.directions.analysis @ change)
    return float(np.mean(seen**2))


def summary(machines: Sequence[JudgedMachine]) -> dict[str, Any]:
    """Return shares in per cent, and rms over the machines in µm."""
    told = [one for one in machines if not one.refused]
    rms = np.array([one.rms_um for one in told])
    before, after = (np.sqrt(np.mean(rms[:, :, column] ** 2, axis=0)).round(2).tolist() for column in (0, 1))
    stated = sum(one.stated for one in told)
    with_sensors, without = (np.mean([one.left_out[place] for one in told]) for place in (0, 1))
    return {
        "machines": len(machines),
        "refused": len(machines) - len(told),
        "taken_percent": _percent([one.taken > 0 for one in told]),
        "decoy_taken_percent": _percent([one.decoys > 0 for one in told]),
        "stuck_taken_percent": _percent([one.stuck > 0 for one in told]),
        "hours": list(HOURS),
        "drift_um": before,
        "left_um": after,
        "worse_percent": _percent([one.rms_um[-1][1] > one.rms_um[-1][0] for one in told]),
        "left_out_nights_um": [round(float(np.sqrt(without)), 2), round(float(np.sqrt(with_sensors)), 2)],
        "coverage_percent": round(100.0 * sum(one.inside for one in told) / max(stated, 1), 1),
    }


def _percent(found: Sequence[bool]) -> float:
    return round(100.0 * float(np.mean(found)), 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge machines of all kinds, and print the shares as one line of JSON."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.sensors", description=__doc__)
    parser.add_argument("--machines", type=int, default=50, help="machines of each of the four kinds")
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first machine")
    parser.add_argument("--csv", type=Path, help="file for one row per machine")
    parser.add_argument("--workers", type=int, help="processes; as many as processors if not given")
    asked = parser.parse_args(arguments)
    numbers = range(asked.first, asked.first + asked.machines)
    with ProcessPoolExecutor(asked.workers) as workers:
        found = {kind: list(workers.map(partial(judged, kind), numbers, chunksize=2)) for kind in KINDS}
    if asked.csv is not None:
        write_rows(asked.csv, [row_of(one) for machines in found.values() for one in machines])
    print(json.dumps({kind: summary(machines) for kind, machines in found.items()}))
    return 0


def row_of(one: JudgedMachine) -> dict[str, str]:
    """Return the row of a machine in the table of the documents."""
    hours = {
        f"{name}_{hour}_um": f"{pair[column]:.5g}"
        for hour, pair in zip(HOURS, one.rms_um, strict=False)
        for column, name in enumerate(("drift", "left"))
    }
    return {
        **{
            name: str(getattr(one, name))
            for name in ("kind", "number", "refused", "nights", "taken", "decoys", "stuck")
        },
        **hours,
        "inside": str(one.inside),
        "stated": str(one.stated),
        "left_out_with_um2": f"{one.left_out[0]:.5g}",
        "left_out_without_um2": f"{one.left_out[1]:.5g}",
    }


def machine_of(row: Mapping[str, str]) -> JudgedMachine:
    """Return the machine of a row."""
    (kind,) = (known for known in KINDS if known == row["kind"])
    number, nights, taken, decoys, stuck, inside, stated = (
        int(row[name]) for name in ("number", "nights", "taken", "decoys", "stuck", "inside", "stated")
    )
    rms = tuple((float(row[f"drift_{hour}_um"]), float(row[f"left_{hour}_um"])) for hour in HOURS)
    left_out = (float(row["left_out_with_um2"]), float(row["left_out_without_um2"]))
    return JudgedMachine(kind, number, row["refused"], nights, taken, decoys, stuck, rms, inside, stated, left_out)
