"""Choice of the next position of a sequential calibration in a slot that is known: the candidate with the largest gain
per second, as a run chooses, compared with the best candidate of a designed remainder of the slot.

The remainder is designed after each position for the time that is left, with the scales that the machine has shown, and
improves the remainder of the step before. Random machines (`twin.uncertainty.random_machines`) are calibrated in both
ways, and both results are compared with the truth. Only positions that end within the slot count; their minutes are
those of a plan that measures them one by one. The mean of the logarithm of the ratio of both results is printed with
its standard error. Printed first: the minutes of the positions that would be chosen for a machine of the family, one
by one and as a set, both station by station. A set is measured on one path, without a withdrawal between two positions.

`python -m benchmarks.designed_remainder --machines 20 --slot 12` takes about ten minutes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from time import perf_counter

import numpy as np

from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import machine_minutes
from agent.planning.design.sequential_candidates import (
    LEAST_CARRY_MIN,
    SequentialCandidates,
    minutes_one_by_one,
    standing_in,
)
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.design.goals import TimeSlotGoal
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch, Mask
from twin.design.sequential import MIN_FOR_SCALES, PositionsSeen, ranked_choices
from twin.errors import DataError
from twin.identification import Options, identify_by_evidence, predicted_vce
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error
from twin.uncertainty.random_machines import (
    DEFLECTION_FORMS,
    THERMOMETER_UNCERTAINTY_K,
    RandomMachine,
    draw_random_machine,
)
from twin.units import S_PER_MIN, UM_PER_MM

GREEDY, REMAINDER = "gain per second", "designed remainder"
COUNTS = (12, 20)
"""Numbers of positions whose minutes are compared."""
_GRID = (16, 8, 8)
_NEAR = 3  # of the turns from the other candidates, the turn that a candidate of a remainder is expected to take
_OVERRUN = 0.3  # share of the slot by which estimated minutes may exceed it; the plan decides what lies within


@dataclass(frozen=True)
class ChoiceOutcome:
    """Result of one calibration: number and minutes of the positions, true and predicted VCE in µm, and the longest
    time of a choice in s."""

    positions: int
    minutes: float
    true_um: float
    predicted_um: float
    choice_s: float


@dataclass(frozen=True, eq=False)
class ChoiceComparison:
    """Calibrations in a slot of `slot_min` machine minutes, without checks and proof."""

    candidates: SequentialCandidates
    slot_min: float

    def outcome(self, machine: RandomMachine, seen: Observations, way: str) -> ChoiceOutcome:
        """Return the result of a calibration of `machine`, of whose candidates `seen` are the measurements."""
        chosen, choice_s = self._path(seen, way)
        job, positions = self.candidates.job, self.candidates.positions
        ends = minutes_one_by_one(job, [positions[index] for index in chosen])
        kept = [index for index, end in zip(chosen, ends.tolist(), strict=True) if end <= self.slot_min]
        measured = seen.select(np.isin(seen.position, kept))
        options = Options(temperature_standard_uncertainty_k=THERMOMETER_UNCERTAINTY_K)
        estimate = identify_by_evidence(lambda n: job.machine.with_order(n).family, measured, job.artefact, options)
        grid, offset = evaluation_grid(job.machine.model.ranges_mm, _GRID), job.tool_offset_mm
        left = machine.truth.deviation(grid) - exact_deviation(estimate.model, grid, offset, estimate.parameters)
        return ChoiceOutcome(
            positions=len(kept),
            minutes=float(ends[len(kept) - 1]),
            true_um=UM_PER_MM * volumetric_error(grid + offset, left).aligned_mm,
            predicted_um=UM_PER_MM * predicted_vce(estimate, grid, offset).aligned_mm,
            choice_s=choice_s,
        )

    def _path(self, seen: Observations, way: str) -> tuple[list[int], float]:
        """Return the candidates in the order in which they are chosen, and the longest time of a choice in s."""
        state, chosen, spent_min, longest_s = self.candidates.nothing_seen(), list[int](), 0.0, 0.0
        remainder = self._first_remainder if way == REMAINDER else []
        while True:
            began = perf_counter()
            allowed = np.ones(len(self.candidates.positions), dtype=bool)
            allowed[chosen] = False
            last = chosen[-1] if chosen else None
            standing = None if last is None else standing_in(self.candidates.positions[last])
            left = (1.0 + _OVERRUN) * self.slot_min - spent_min
            minutes = self.candidates.seconds(standing) / S_PER_MIN
            worth = self.candidates.seconds(standing, LEAST_CARRY_MIN)
            ranked = [index for index in ranked_choices(state, worth, allowed).tolist() if minutes[index] <= left]
            if not ranked:
                return chosen, longest_s
            if way == REMAINDER and len(chosen) >= MIN_FOR_SCALES:
                remainder = self._remainder(state, allowed, self.slot_min - spent_min, last, remainder)
            planned = [index for index in ranked if index in remainder and index not in chosen]
            pick = (planned or ranked)[0]
            longest_s = max(longest_s, perf_counter() - began) if chosen else 0.0
            spent_min += float(minutes[pick])
            chosen.append(pick)
            state = state.after(seen.select(seen.position == pick))

    @cached_property
    def _first_remainder(self) -> list[int]:
        start = self.candidates.nothing_seen()
        return self._remainder(start, np.ones(len(self.candidates.positions), dtype=bool), self.slot_min, None, [])

    def _remainder(
        self, state: PositionsSeen, allowed: Mask, minutes: float, last: int | None, before: Sequence[int]
    ) -> list[int]:
        """Return the best candidates for the `minutes` that are left after candidate `last`, improved from those of the
        step before; none if the time is too short for two."""
        positions, at = self.candidates.positions, np.flatnonzero(allowed)
        made = state.model.candidates
        left = replace(
            made,
            positions=tuple(positions[index] for index in at),
            balls=made.balls[at],
            factors=made.factors[at] / state.scales.noise,
            precision=np.asarray(np.linalg.inv(state.covariance), dtype=np.float64),
        )
        costs = MeasuringCosts(
            minutes=self._usual_minutes[at],
            stations=np.array([position.station for position in left.positions]),
            standing_at=None if last is None else positions[last].station,
        )
        number_of = {index: number for number, index in enumerate(at.tolist())}
        start = [number_of[index] for index in before if index in number_of]
        try:
            found = TimeSlotGoal(minutes).select(ExchangeSearch(left, costs), start)
        except DataError:  # too short for two positions
            return []
        return [int(at[number]) for number in found]

    @cached_property
    def _usual_minutes(self) -> Array:
        """Minutes (N,) of each candidate after one to which the mount turns quickly, at the same station."""
        every = [self.candidates.seconds(standing_in(position)) for position in self.candidates.positions]
        return np.asarray(np.sort(np.array(every), axis=0)[_NEAR - 1] / S_PER_MIN)


def minutes_of_both(candidates: SequentialCandidates, count: int) -> tuple[float, float]:
    """Return the minutes of the first `count` positions that would be chosen for a machine of the family, measured one
    by one and as a set, in the same order."""
    first = sorted(islice(candidates.sequence(None), count), key=lambda position: position.station)
    return float(minutes_one_by_one(candidates.job, first)[-1]), machine_minutes(candidates.job, first).total


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.designed_remainder")
    parser.add_argument("--case", default="quick")
    parser.add_argument("--machines", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first machine")
    parser.add_argument("--slot", type=float, default=12.0, help="in min")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args(arguments)
    job = load_case(shipped_case(asked.case).settings)
    comparison = ChoiceComparison(SequentialCandidates(job), asked.slot)
    for count in COUNTS:
        alone, together = minutes_of_both(comparison.candidates, count)
        print(f"{count} positions: {alone:.2f} min one by one, {together:.2f} min as a set", flush=True)
    planned = job.procedure.plan(comparison.candidates.positions).observations
    every: dict[str, list[ChoiceOutcome]] = {GREEDY: [], REMAINDER: []}
    for number in range(asked.first, asked.first + asked.machines):
        rng = generator(asked.seed, number)
        form = DEFLECTION_FORMS[number % len(DEFLECTION_FORMS)]
        machine = draw_random_machine(job.machine, job.tool_offset_mm, form, rng)
        seen = machine.measure(planned, job.artefact, rng)
        for way, outcomes in every.items():
            one = comparison.outcome(machine, seen, way)
            outcomes.append(one)
            print(
                f"{number:3d} {way:18s} {one.positions} positions, {one.minutes:.2f} min, true {one.true_um:.3f} µm, "
                f"predicted {one.predicted_um:.3f} µm, choice {one.choice_s:.2f} s",
                flush=True,
            )
    for name in ("true_um", "predicted_um"):
        values = {way: np.array([getattr(one, name) for one in outcomes]) for way, outcomes in every.items()}
        ratio = np.log(values[REMAINDER] / values[GREEDY])
        rms = ", ".join(f"{way} {np.sqrt((value**2).mean()):.3f}" for way, value in values.items())
        error = ratio.std(ddof=1) / np.sqrt(len(ratio)) if len(ratio) > 1 else np.nan
        print(f"{name}: rms {rms}; mean log ratio {ratio.mean():+.3f} ± {error:.3f}")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
