"""Foreign machines on which something goes wrong while they are measured, and what the program says about it.

Each case is a fault, a set of positions and the order of its stations. For many machines, the true volumetric error
(VE) before and the true volumetric error with compensation (VCE) are compared with the prediction, and the findings are
counted. The fault `none` gives the false alarms.

    python -m campaigns.foreign.faults --machines 300 --case none --case step-12 [--set S3] [--order 2413]

One line of JSON for each case. `caught` is the share of machines that a gate of the estimate refuses, `named` the share
in which the likeliest finding is the true one.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from agent.results.gates.estimate_gates import estimate_gates
from agent.results.gates.required_gates import names_of_failed
from agent.settings.schema import GateSettings
from campaigns.foreign.artefact import (
    S3,
    STATIONS_MM,
    ForeignBar,
    MeasuringConditions,
    measure_at,
    tilted_bar,
)
from campaigns.foreign.machine import GRID, TOOL, ForeignMachine, foreign_machine
from campaigns.foreign.score import family_of, true_error_um
from campaigns.foreign.trials import SETS, Places, places_of
from twin.artefact.observations import Observations
from twin.identification import identify_by_evidence
from twin.identification.predicted import expected_vce, field_forms

_SEED = 29


@dataclass(frozen=True)
class Measurement:
    """Ball centres that were measured, and the machine as it is after the measurement."""

    seen: Observations
    machine: ForeignMachine


Fault = Callable[[ForeignMachine, ForeignBar, Places, int], Measurement]
"""Function that measures a bar on a machine at the given places; the integer seeds the noise."""


def nothing(machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int) -> Measurement:
    return Measurement(measure_at(machine, bar, places, np.random.default_rng(seed)).seen, machine)


def crash(
    machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, change_rad: float, position: int = 11
) -> Measurement:
    """Let the squareness of Z to X change by `change_rad` before `position` is measured."""
    after = replace(machine, squareness=machine.squareness + np.array([0.0, change_rad, 0.0]))
    first, last = (measure_at(one, bar, places, np.random.default_rng(seed)).seen for one in (machine, after))
    return Measurement(joined(first.select(first.position < position), last.select(last.position >= position)), after)


def play(machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, axis: int, ball: int) -> Measurement:
    """Let an axis that has 10 µm of lost motion reverse before `ball` in every position."""
    seen = measure_at(machine, bar, places, np.random.default_rng(seed)).seen
    return Measurement(shifted(seen, axis, seen.ball >= ball), machine)


def play_by_side(machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, axis: int) -> Measurement:
    """Let an axis that has 10 µm of lost motion be pushed to the other flank beyond the middle of its travel."""
    seen = measure_at(machine, bar, places, np.random.default_rng(seed)).seen
    middle = 0.5 * sum(machine.ranges[axis])
    return Measurement(shifted(seen, axis, seen.axis_positions[:, axis] > middle), machine)


def lag(
    machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, axis: int, lost_mm: float = 0.01
) -> Measurement:
    """Let an axis have lost motion."""
    seen = measure_at(machine, bar, places, np.random.default_rng(seed)).seen
    return Measurement(shifted_by_direction(seen, axis, lost_mm), machine)


def shifted_by_direction(seen: Observations, axis: int, lost_mm: float) -> Observations:
    """Return the observations of an axis that lags behind its display by half of its lost motion in the direction in
    which it moved last, also from one position to the next."""
    displayed = seen.axis_positions.copy()
    moved = np.diff(displayed[:, axis], prepend=displayed[0, axis] - 1.0)
    displayed[:, axis] += 0.5 * lost_mm * np.sign(moved)
    return replace(seen, axis_positions=displayed)


def shifted(seen: Observations, axis: int, rows: np.ndarray) -> Observations:
    """Return the observations with 10 µm more on the display of an axis in the rows of the mask `rows` (n,)."""
    displayed = seen.axis_positions.copy()
    displayed[rows, axis] += 0.01
    return replace(seen, axis_positions=displayed)


def sag(machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, ends_mm: float) -> Measurement:
    """Let the ends of the bar hang by `ends_mm` below its middle if it is horizontal: two cantilevers of constant
    section under their own weight, w(s) = (s⁴ - 4 s³ + 6 s²) / 3 at the share s of the length (Euler and Bernoulli)."""
    seen = measure_at(machine, bar, places, np.random.default_rng(seed)).seen
    assert seen.azimuth_rad is not None
    azimuth, elevation = seen.azimuth_rad, seen.elevation_rad
    along = np.stack((np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)), 1)
    across = -np.array([0.0, 0.0, 1.0]) + along * along[:, 2:]
    share = np.abs(bar.certified[seen.ball, 0]) / np.abs(bar.certified[:, 0]).max()
    hanging = ends_mm * (share**4 - 4.0 * share**3 + 6.0 * share**2) / 3.0
    return Measurement(replace(seen, axis_positions=seen.axis_positions + hanging[:, None] * across), machine)


def misread(machine: ForeignMachine, bar: ForeignBar, places: Places, seed: int, *, error_k: float) -> Measurement:
    """Let the thermometer of the bar read `error_k` too high."""
    conditions = MeasuringConditions(thermometer_error_k=error_k)
    return Measurement(measure_at(machine, bar, places, np.random.default_rng(seed), conditions).seen, machine)


def joined(first: Observations, last: Observations) -> Observations:
    """Return the rows of both observations, which have the same tools."""
    assert first.azimuth_rad is not None
    assert last.azimuth_rad is not None
    return Observations(
        position=np.concatenate((first.position, last.position)),
        ball=np.concatenate((first.ball, last.ball)),
        tool=np.concatenate((first.tool, last.tool)),
        axis_positions=np.concatenate((first.axis_positions, last.axis_positions)),
        covariance=np.concatenate((first.covariance, last.covariance)),
        temperature_c=np.concatenate((first.temperature_c, last.temperature_c)),
        elevation_rad=np.concatenate((first.elevation_rad, last.elevation_rad)),
        azimuth_rad=np.concatenate((first.azimuth_rad, last.azimuth_rad)),
        tool_offsets=first.tool_offsets,
    )


FAULTS: Mapping[str, Fault] = {
    "none": nothing,
    "step-4": partial(crash, change_rad=4e-6),
    "step-12": partial(crash, change_rad=12e-6),
    "step-30": partial(crash, change_rad=30e-6),
    "play-x": partial(play, axis=0, ball=6),
    "play-z": partial(play, axis=2, ball=6),
    "side-x": partial(play_by_side, axis=0),
    "side-y": partial(play_by_side, axis=1),
    "lag-x": partial(lag, axis=0),
    "lag-y": partial(lag, axis=1),
    "lag-z": partial(lag, axis=2),
    "sag-20": partial(sag, ends_mm=0.02),
    "thermometer-0.5": partial(misread, error_k=0.5),
    "thermometer-1": partial(misread, error_k=1.0),
    "thermometer-2": partial(misread, error_k=2.0),
}


@dataclass(frozen=True)
class FaultyRun:
    """Fault, set of positions, and order of the stations; `closing` repeats three positions at the first station."""

    fault: str
    set_name: str = "S3"
    order: str = "1234"
    closing: bool = False

    @property
    def places(self) -> Places:
        if self.set_name == "designed":
            here = dict(places_of("designed"))
            listed = [(STATIONS_MM[int(one) - 1], here[STATIONS_MM[int(one) - 1]]) for one in self.order]
        else:
            listed = [(STATIONS_MM[int(one) - 1], SETS[self.set_name]) for one in self.order]
        return [*listed, (listed[0][0], S3[::2])] if self.closing else listed


@dataclass(frozen=True)
class Found:
    """True and predicted errors of one machine in µm, the gates that refuse it, and the likeliest error of a step and
    pattern of shifts."""

    before_um: float
    after_um: float
    predicted_um: float
    refused: tuple[str, ...]
    false_alarm: float
    error: str
    pattern: str
    hidden_um: float


def one_machine(case: FaultyRun, number: int) -> Found:
    """Return what is found on machine `number`."""
    rng = np.random.default_rng([number, _SEED])
    machine, bar = foreign_machine(rng), tilted_bar(rng)
    measured = FAULTS[case.fault](machine, bar, case.places, int(rng.integers(2**31)))
    estimate = identify_by_evidence(family_of, measured.seen, bar.artefact)
    step, pattern = estimate.step, estimate.pattern
    assert step is not None
    assert pattern is not None
    return Found(
        before_um=true_error_um(measured.machine),
        after_um=true_error_um(measured.machine, estimate),
        predicted_um=expected_vce(estimate, field_forms(estimate, GRID, TOOL)).aligned_um,
        refused=names_of_failed(estimate_gates(estimate, GateSettings())),
        false_alarm=step.false_alarm,
        error=step.suspects[0].jump.error,
        pattern=pattern.suspects[0].cause,
        hidden_um=0.0 if step.hidden is None else step.hidden.vce_um,
    )


def summary(case: FaultyRun, found: Sequence[Found]) -> dict[str, object]:
    """Return the means over the machines of a case, and shares in per cent."""
    ratios = np.array([one.after_um / one.predicted_um for one in found])
    gates = sorted({name for one in found for name in one.refused})
    by_gate = {name: _percent([name in one.refused for one in found]) for name in gates}
    return {
        "fault": case.fault,
        "set": case.set_name,
        "order": case.order + ("+1" if case.closing else ""),
        "machines": len(found),
        "true_before_um": round(float(np.mean([one.before_um for one in found])), 2),
        "true_after_um": round(float(np.mean([one.after_um for one in found])), 2),
        "predicted_um": round(float(np.mean([one.predicted_um for one in found])), 2),
        "ratio": round(float(ratios.mean()), 3),
        "ratio_sd": round(float(ratios.std()), 3),
        "caught_percent": _percent([bool(one.refused) for one in found]),
        **{
            f"gate_{name.replace(' ', '_')}_percent": _percent([name in one.refused for one in found]) for name in gates
        },
        "refused_percent": by_gate,
        "b0z_named_percent": _percent([one.error == "B0Z" for one in found]),
        "pattern": max({one.pattern for one in found}, key=lambda name: sum(one.pattern == name for one in found)),
        "hidden_step_um": round(float(np.mean([one.hidden_um for one in found])), 2),
    }


def _percent(shares: Sequence[bool]) -> float:
    return round(100.0 * float(np.mean(shares)), 1)


def main() -> int:
    """Carry out the cases of the command line."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.foreign.faults", description="Measure with faults.")
    parser.add_argument("--machines", type=int, default=100, help="machines of each case")
    parser.add_argument("--case", choices=sorted(FAULTS), action="append", help="a fault; all if not given")
    parser.add_argument("--set", choices=[*SETS, "designed"], default="S3", help="set of positions")
    parser.add_argument("--order", default="1234", help="order of the stations")
    parser.add_argument("--closing", action="store_true", help="repeat three positions at the first station")
    given = parser.parse_args()
    for fault in given.case or FAULTS:
        case = FaultyRun(fault, given.set, given.order, given.closing)
        with ProcessPoolExecutor() as workers:
            found = list(workers.map(partial(one_machine, case), range(given.machines), chunksize=4))
        print(json.dumps(summary(case, found)), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
