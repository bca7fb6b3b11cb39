"""Study of sequential calibrations: volumetric compensated error (VCE) against machine time, and how often the limits
of the VCE that are stated at the end contain the true one.

The machines have more errors than the model describes (`twin.uncertainty.random_machines`). Each is calibrated
sequentially, as a run does it: the next position is chosen from its own simulated measurements, and the measurement
ends when the upper 95 % limit of the predicted VCE is below a target, or when the time of the position set of the case
is over. A rule that ends at a lucky moment would state too small an error; the observed coverage shows it.

On some of the machines, the first positions of the set of the case, the first positions that a design chooses
beforehand and those chosen sequentially are compared at equal numbers of positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from agent.planning.cycle_time import machine_minutes
from agent.planning.design.sequential_candidates import (
    LEAST_CARRY_MIN,
    MIN_POSITIONS,
    SequentialCandidates,
    standing_in,
)
from agent.studies.sequential_figure import VceCurve, draw
from agent.studies.study import StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.design.sequential import PositionsSeen, ranked_choices
from twin.identification import Estimate, Options, identify, identify_by_evidence, predicted_vce
from twin.machine.forward_model import exact_deviation
from twin.machine.machine_description import MachineDescription
from twin.machine.volumetric import evaluation_grid, volumetric_error
from twin.uncertainty.coverage import ObservedCoverage, observed_coverage
from twin.uncertainty.random_machines import (
    DEFLECTION_FORMS,
    THERMOMETER_UNCERTAINTY_K,
    RandomMachine,
    draw_random_machine,
)
from twin.uncertainty.volumetric_limits import COVERAGE, volumetric_limits
from twin.units import MM_PER_UM, S_PER_MIN, UM_PER_MM

NAME = "sequential"
NAMED, DESIGNED, SEQUENTIAL = "position set", "designed", "sequential"
TARGET_COUNTS = (8, 14)
"""Numbers of positions of the design whose expected VCE gives the targets."""

_LIMIT_OVER_EXPECTED = 1.5  # upper 95 % limit over expected VCE of a usual machine
_GRID = (16, 8, 8)
_CURVES_EVERY = 10  # every tenth machine is measured in all three ways
_CURVE_STEP = 4


@dataclass(frozen=True, eq=False)
class StatedVce:
    """VCE of one machine as stated after some positions, and the true one, in µm. `ending` says what the positions are,
    or which target ended the measurement; `reached` is True if the target was reached before the time was over."""

    form: str
    ending: str
    positions: int
    minutes: float
    true_um: float
    expected_um: float
    limits_um: tuple[float, float]
    order: int
    reached: bool = False

    @property
    def held(self) -> bool:
        return self.limits_um[0] <= self.true_um <= self.limits_um[1]


@dataclass(frozen=True, eq=False)
class SequentialStudyTask:
    """Task that calibrates one random machine in several ways, given its number and the form of its deflection.

    `start` is the state before the first position. `positions` contains the N candidates, then those of the position
    set, and `planned` the measurement of all of them. `seconds` (N + 1, N) is the time of each candidate after each
    candidate and, in the last row, at the start. `designed` contains the candidates in the order of the design.
    `limit_s` is the time in s for all measured positions, and `set_minutes` the minutes of the first positions of the
    position set.
    """

    machine: MachineDescription
    artefact: Artefact
    options: Options
    start: PositionsSeen
    planned: Observations
    seconds: Array
    designed: tuple[int, ...]
    set_minutes: tuple[float, ...]
    limit_s: float
    targets_um: tuple[float, ...]
    tool_offset: Array
    by_evidence: bool
    seed: int

    def __call__(self, item: tuple[int, str]) -> list[StatedVce]:
        number, form = item
        rng = generator(self.seed, number)
        machine = draw_random_machine(self.machine, self.tool_offset, form, rng)
        seen = machine.measure(self.planned, self.artefact, rng)
        with_curves = number % _CURVES_EVERY == 0
        path, stops = self._sequential(machine, seen, whole=with_curves)
        return [*stops, *self._curves(machine, seen, path)] if with_curves else stops

    @property
    def _candidates(self) -> int:
        return len(self.seconds) - 1

    def _sequential(
        self, machine: RandomMachine, seen: Observations, *, whole: bool
    ) -> tuple[list[int], list[StatedVce]]:
        """Return the candidates in the order in which a sequential calibration measures them, and what it states where
        it ends for each target. If `whole` is True, the candidates continue to the end of the slot."""
        state, chosen, spent_s = self.start, list[int](), 0.0
        stops = list[StatedVce]()
        targets = sorted(self.targets_um, reverse=True)
        while True:
            allowed = np.ones(self._candidates, dtype=bool)
            allowed[chosen] = False
            seconds = self.seconds[chosen[-1] if chosen else -1]
            if state.count >= MIN_POSITIONS and targets and state.is_near(MM_PER_UM * targets[0]):
                stated = self._stated(machine, seen, chosen, spent_s, f"target {targets[0]:.2f} µm")
                while targets and stated.limits_um[1] < targets[0]:
                    ending = f"target {targets.pop(0):.2f} µm"
                    stops.append(replace(stated, ending=ending, reached=True))
            ranked = [
                index
                for index in ranked_choices(state, seconds, allowed).tolist()
                if spent_s + seconds[index] <= self.limit_s
            ]
            if not ranked or not (targets or whole):
                break
            spent_s += float(seconds[ranked[0]])
            chosen.append(ranked[0])
            state = state.after(seen.select(seen.position == chosen[-1]))
        for target in targets:
            stops.append(self._stated(machine, seen, chosen, spent_s, f"target {target:.2f} µm"))
        return chosen, stops

    def _curves(self, machine: RandomMachine, seen: Observations, path: Sequence[int]) -> Iterator[StatedVce]:
        """Yield what is stated after some of the positions of each of the three ways."""
        of_set = tuple(range(self._candidates, self._candidates + len(self.set_minutes)))
        for count in range(MIN_POSITIONS, max(len(path), len(of_set)) + 1, _CURVE_STEP):
            for name, order in ((SEQUENTIAL, path), (DESIGNED, self.designed)):
                if count <= len(order):
                    yield self._stated(machine, seen, order[:count], self._seconds_of(order[:count]), name)
            if count <= len(of_set):
                yield self._stated(machine, seen, of_set[:count], S_PER_MIN * self.set_minutes[count - 1], NAMED)

    def _seconds_of(self, chosen: Sequence[int]) -> float:
        return float(self.seconds[-1, chosen[0]] + sum(self.seconds[one, other] for one, other in pairwise(chosen)))

    def _stated(
        self, machine: RandomMachine, seen: Observations, chosen: Sequence[int], spent_s: float, ending: str
    ) -> StatedVce:
        estimate = self._estimate(seen.select(np.isin(seen.position, list(chosen))))
        grid, offset = evaluation_grid(self.machine.model.ranges_mm, _GRID), self.tool_offset
        left = machine.truth.deviation(grid) - exact_deviation(estimate.model, grid, offset, estimate.parameters)
        limits = volumetric_limits(estimate, grid, offset)
        return StatedVce(
            form=machine.form,
            ending=ending,
            positions=len(chosen),
            minutes=spent_s / S_PER_MIN,
            true_um=UM_PER_MM * volumetric_error(grid + offset, left).aligned_mm,
            expected_um=UM_PER_MM * predicted_vce(estimate, grid, offset).aligned_mm,
            limits_um=limits.vce_um,
            order=max(estimate.model.highest_order),
        )

    def _estimate(self, seen: Observations) -> Estimate:
        own = self.machine
        if not self.by_evidence:
            return identify(own.model, seen, self.artefact, own.family, self.options)
        return identify_by_evidence(lambda order: own.with_order(order).family, seen, self.artefact, self.options)


def run(case: StudyCase) -> StudyResult:
    """Calibrate `case.machines` random machines with alternating forms of deflection, and compare what each calibration
    states at its end with the truth."""
    task = _task(case)
    machines = [(number, DEFLECTION_FORMS[number % len(DEFLECTION_FORMS)]) for number in range(case.machines)]
    found = case.map(task, machines)
    every = [one for stated in found for one in stated]
    endings = tuple(f"target {target:.2f} µm" for target in sorted(task.targets_um, reverse=True))
    rng = generator(case.seed, case.machines)
    coverage = {ending: _by_form([one for one in every if one.ending == ending], rng) for ending in endings}
    curves = tuple(_curve(name, [one for one in every if one.ending == name]) for name in (NAMED, DESIGNED, SEQUENTIAL))
    return StudyResult(
        name=NAME,
        title="Positions that are chosen during the run",
        columns=COLUMNS,
        rows=[_row(number, one) for number, stated in enumerate(found) for one in stated],
        summary={
            "nominal": COVERAGE,
            "candidates": len(task.seconds) - 1,
            "slot_minutes": task.limit_s / S_PER_MIN,
            "by_target": {ending: _summary([one for one in every if one.ending == ending]) for ending in endings},
            "coverage": {
                ending: {form: [round(one.observed, 4), round(one.standard_error, 4)] for form, one in shares.items()}
                for ending, shares in coverage.items()
            },
            "curves": {curve.name: curve.as_json() for curve in curves},
        },
        draw=partial(draw, curves=curves, coverage=coverage),
        size_in=(10.0, 4.4),
    )


def _task(case: StudyCase) -> SequentialStudyTask:
    candidates = SequentialCandidates(case.job)
    held_out = set(case.job.held_out)
    listed = tuple(one for one in case.positions() if one not in held_out)
    planned = case.procedure.plan((*candidates.positions, *listed))
    of_set = planned.positions[len(candidates.positions) :]
    minutes = machine_minutes(replace(case.job, positions=of_set), of_set)
    of_each = [minutes.per_position[position] for position in of_set]
    # carrying is shared out evenly: the set is measured station by station
    set_minutes = np.cumsum(of_each) + minutes.carrying * np.arange(1, len(of_each) + 1) / len(of_each)
    start = candidates.nothing_seen()
    limit_s = S_PER_MIN * minutes.total
    seconds = _seconds(candidates)
    designed = _designed(candidates.positions, start, seconds, limit_s)
    form, chosen = start.model.candidates, case.job.settings.identification
    targets = [_LIMIT_OVER_EXPECTED * UM_PER_MM * form.vce(designed[:count]).aligned_mm for count in TARGET_COUNTS]
    return SequentialStudyTask(
        machine=case.machine,
        artefact=case.artefact,
        options=replace(case.options, temperature_standard_uncertainty_k=THERMOMETER_UNCERTAINTY_K),
        start=start,
        planned=planned.observations,
        seconds=seconds,
        designed=designed,
        set_minutes=tuple(set_minutes.tolist()),
        limit_s=limit_s,
        targets_um=tuple(targets),
        tool_offset=case.tool_offset,
        by_evidence=chosen.order == "evidence",
        seed=case.seed,
    )


def _seconds(candidates: SequentialCandidates) -> Array:
    standing = [*(standing_in(position) for position in candidates.positions), None]
    return np.array([candidates.seconds(one, LEAST_CARRY_MIN) for one in standing])


def _designed(positions: Sequence[Position], start: PositionsSeen, seconds: Array, limit_s: float) -> tuple[int, ...]:
    """Return the candidates in the order of falling gain per second, as they are chosen before anything is measured."""
    state, chosen = start, list[int]()
    while True:
        allowed = np.ones(len(positions), dtype=bool)
        allowed[chosen] = False
        now = seconds[chosen[-1] if chosen else -1]
        ranked = [index for index in ranked_choices(state, now, allowed).tolist() if now[index] <= limit_s]
        if not ranked:
            return tuple(chosen)
        limit_s -= float(now[ranked[0]])
        chosen.append(ranked[0])
        state = state.planned(ranked[0])


COLUMNS = (
    "machine",
    "form",
    "ending",
    "positions",
    "minutes",
    "vce_true_aligned_um",
    "vce_predicted_aligned_um",
    "vce_lower_um",
    "vce_upper_um",
    "order",
    "reached",
    "held",
)


def _row(number: int, one: StatedVce) -> tuple[str | int | float | bool, ...]:
    lower, upper = one.limits_um
    figures = (one.positions, one.minutes, one.true_um, one.expected_um, lower, upper)
    return (number, one.form, one.ending, *figures, one.order, one.reached, one.held)


def _by_form(stated: Sequence[StatedVce], rng: np.random.Generator) -> dict[str, ObservedCoverage]:
    """Return the share of the machines whose stated limits contain the true VCE, for each form, for those that reached
    their target, and for all."""
    groups = {form: [one for one in stated if one.form == form] for form in DEFLECTION_FORMS}
    groups |= {"reached": [one for one in stated if one.reached], "all": list(stated)}
    return {
        name: observed_coverage([np.array([0.0 if one.held else 1.0]) for one in of], COVERAGE, rng)
        for name, of in groups.items()
        if of
    }


def _summary(stated: Sequence[StatedVce]) -> Mapping[str, object]:
    reached = [one for one in stated if one.reached]
    return {
        "machines": len(stated),
        "reached": len(reached),
        "below_lower": sum(one.true_um < one.limits_um[0] for one in stated),
        "above_upper": sum(one.true_um > one.limits_um[1] for one in stated),
        "true_above_target": sum(one.true_um > float(one.ending.split()[1]) for one in reached),
        "positions_mean": float(np.mean([one.positions for one in stated])),
        "minutes_mean": float(np.mean([one.minutes for one in stated])),
        "vce_true_rms_um": float(np.sqrt(np.mean([one.true_um**2 for one in stated]))),
        "vce_predicted_rms_um": float(np.sqrt(np.mean([one.expected_um**2 for one in stated]))),
    }


def _curve(name: str, stated: Sequence[StatedVce]) -> VceCurve:
    counts = sorted({one.positions for one in stated})
    of = [[one for one in stated if one.positions == count] for count in counts]
    return VceCurve(
        name,
        tuple(counts),
        tuple(float(np.mean([one.minutes for one in group])) for group in of),
        tuple(float(np.sqrt(np.mean([one.true_um**2 for one in group]))) for group in of),
        tuple(float(np.mean([one.held for one in group])) for group in of),
    )
