"""Study of sequential calibrations: volumetric compensated error (VCE) against machine time, and how often the limits
of the VCE that are stated at the end contain the true one.

The machines have more errors than the model describes (`twin.uncertainty.random_machines`). Each is calibrated
sequentially, as a run does it: the next position is chosen from its own simulated measurements, and the measurement
ends when the upper 95 % limit of the predicted VCE is below a target, or when the time of the position set of the
study is over, but not before 20 minutes. A rule that ends at a lucky moment would state too small an error; the
observed coverage shows it.

On some of the machines, three ways to choose the positions are compared in machine time: the first positions of the
set of the study, sets that are designed for several lengths of the slot, and the sequential choice. Beside them
stands a lower bound of the expected VCE of all sets of the designs' candidates (`twin.design.relaxed_design`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np

from agent.planning.cycle_time import machine_minutes, minutes_at_balls, set_alone
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.design_result import DesignResult, find_design
from agent.planning.design.feasibility import line_over_balls, timed_among
from agent.planning.design.sequential_candidates import (
    LEAST_CARRY_MIN,
    MIN_POSITIONS,
    SequentialCandidates,
    minutes_one_by_one,
    standing_in,
)
from agent.planning.design.variants import BALL_SHARES
from agent.planning.job import Job
from agent.studies.sequential_figure import VceCurve, draw
from agent.studies.study import StudyCase, StudyResult
from agent.studies.workers import generator
from drivers.errors import InputError
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions, joined_candidates
from twin.design.goals import TimeSlotGoal
from twin.design.relaxed_design import InformationBound, information_bound
from twin.design.sequential import PositionsSeen, ranked_choices
from twin.identification import Estimate, Options, identify, identify_by_evidence, predicted_vce
from twin.machine.forward_model import exact_deviation
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
# two of five machines are measured in all three ways; five and the number of forms have no common divisor
_CURVES_OF, _CURVES_EVERY = 2, 5
_CURVE_STEP, _SET_STEP = 3, 8
_SLOT_SHARES = (0.3, 0.45, 0.6, 0.8, 1.0)  # slots of the designs, as shares of the longest
_LONGEST_MIN = 20.0  # machine time in min up to which the three ways are compared
_DESIGN_GRID_DEG = 15.0
_UNDERCUT = 0.95  # share of the shortest time on the line over the balls that no candidate undercuts


@dataclass(frozen=True, eq=False)
class StatedVce:
    """VCE of one machine as stated after some positions, and the true one, in µm. `ending` says what the positions are,
    or which target ended the measurement; `reached` is True if the target was reached before the time was over. `point`
    is the number of the point on a curve."""

    form: str
    ending: str
    positions: int
    minutes: float
    true_um: float
    expected_um: float
    limits_um: tuple[float, float]
    order: int
    reached: bool = False
    point: int = 0

    @property
    def held(self) -> bool:
        return self.limits_um[0] <= self.true_um <= self.limits_um[1]


@dataclass(frozen=True)
class TimedSet:
    """Positions, as indices of the planned measurement, that a person would measure as a set, and their machine time
    in min."""

    indices: tuple[int, ...]
    minutes: float


@dataclass(frozen=True, eq=False)
class SequentialStudyTask:
    """Task that calibrates one random machine in several ways, given its number and the form of its deflection.

    `start` is the state before the first position. `planned` is the measurement of the N candidates and of all
    positions of the `sets`, which map the name of a way to choose positions to its sets of growing length. `seconds`
    (N + 1, N) is the time of each candidate after each candidate and, in the last row, at the start, by which the
    candidates are chosen. `limit_s` is the time in s for all measured positions.
    """

    job: Job
    options: Options
    start: PositionsSeen
    candidates: tuple[Position, ...]
    planned: Observations
    seconds: Array
    sets: Mapping[str, tuple[TimedSet, ...]]
    limit_s: float
    targets_um: tuple[float, ...]
    by_evidence: bool
    seed: int

    def __call__(self, item: tuple[int, str]) -> list[StatedVce]:
        number, form = item
        rng = generator(self.seed, number)
        machine = draw_random_machine(self.job.machine, self.job.tool_offset_mm, form, rng)
        seen = machine.measure(self.planned, self.job.artefact, rng)
        with_curves = number % _CURVES_EVERY < _CURVES_OF
        path, stops = self._sequential(machine, seen, whole=with_curves)
        return [*stops, *self._curves(machine, seen, path)] if with_curves else stops

    @property
    def _candidates(self) -> int:
        return len(self.seconds) - 1

    def _sequential(
        self, machine: RandomMachine, seen: Observations, *, whole: bool
    ) -> tuple[list[int], list[StatedVce]]:
        """Return the candidates in the order in which a sequential calibration measures them, and what it states where
        it ends for each target. If `whole` is True, the candidates continue to the end of the time."""
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
        ends = minutes_one_by_one(self.job, [self.candidates[index] for index in path])
        chosen = tuple(
            TimedSet(tuple(path[:count]), float(ends[count - 1]))
            for count in range(MIN_POSITIONS, len(path) + 1, _CURVE_STEP)
            if ends[count - 1] <= _LONGEST_MIN
        )
        for name, sets in (*self.sets.items(), (SEQUENTIAL, chosen)):
            for point, one in enumerate(sets):
                stated = self._stated(machine, seen, one.indices, S_PER_MIN * one.minutes, name)
                yield replace(stated, point=point)

    def _stated(
        self, machine: RandomMachine, seen: Observations, chosen: Sequence[int], spent_s: float, ending: str
    ) -> StatedVce:
        estimate = self._estimate(seen.select(np.isin(seen.position, list(chosen))))
        grid, offset = evaluation_grid(self.job.machine.model.ranges_mm, _GRID), self.job.tool_offset_mm
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
        own, artefact = self.job.machine, self.job.artefact
        if not self.by_evidence:
            return identify(own.model, seen, artefact, own.family, self.options)
        return identify_by_evidence(lambda order: own.with_order(order).family, seen, artefact, self.options)


def run(case: StudyCase) -> StudyResult:
    """Calibrate `case.machines` random machines with alternating forms of deflection, and compare what each calibration
    states at its end with the truth."""
    candidates = SequentialCandidates(case.job)
    jobs = {case.job.settings.tool: case.job}
    problems = [DesignProblem(jobs, _DESIGN_GRID_DEG, set_alone, share) for share in BALL_SHARES]
    designs = _designed_sets(case, problems)
    task = _task(case, candidates, designs)
    machines = [(number, DEFLECTION_FORMS[number % len(DEFLECTION_FORMS)]) for number in range(case.machines)]
    found = case.map(task, machines)
    every = [one for stated in found for one in stated]
    endings = tuple(f"target {target:.2f} µm" for target in sorted(task.targets_um, reverse=True))
    rng = generator(case.seed, case.machines)
    coverage = {ending: _by_form([one for one in every if one.ending == ending], rng) for ending in endings}
    labels = {NAMED: case.position_set or NAMED, DESIGNED: DESIGNED, SEQUENTIAL: SEQUENTIAL}
    curves = tuple(_curve(label, [one for one in every if one.ending == name]) for name, label in labels.items())
    bounds = _bounds(case, problems, [one.minutes for one in designs])
    expected = [(one.minutes, UM_PER_MM * one.valuation.after.aligned_mm) for one in designs]
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
            "expected_of_designs": {"minutes": [x for x, _ in expected], "vce_um": [y for _, y in expected]},
            "information_bound": {
                "minutes": [one.time for one in bounds],
                "vce_um": [UM_PER_MM * one.vce_mm for one in bounds],
            },
        },
        draw=partial(draw, curves=curves, expected=expected, bounds=bounds, coverage=coverage),
        size_in=(10.5, 4.6),
    )


def _task(case: StudyCase, candidates: SequentialCandidates, designs: Sequence[DesignResult]) -> SequentialStudyTask:
    listed = _listed_set(case)
    sets = [one.positions for one in designs]
    planned = case.procedure.plan((*candidates.positions, *listed.positions, *(p for one in sets for p in one)))
    first, designed = len(candidates.positions) + len(listed.positions), list[TimedSet]()
    for one in designs:
        designed.append(TimedSet(tuple(range(first, first + len(one.positions))), one.minutes))
        first += len(one.positions)
    start = candidates.nothing_seen()
    form, chosen = start.model.candidates, case.job.settings.identification
    first_chosen = islice(candidates.sequence(None), max(TARGET_COUNTS))
    greedy = [candidates.positions.index(position) for position in first_chosen]
    targets = [_LIMIT_OVER_EXPECTED * UM_PER_MM * form.vce(greedy[:count]).aligned_mm for count in TARGET_COUNTS]
    return SequentialStudyTask(
        job=case.job,
        options=replace(case.options, temperature_standard_uncertainty_k=THERMOMETER_UNCERTAINTY_K),
        start=start,
        candidates=candidates.positions,
        planned=planned.observations,
        seconds=_seconds(candidates),
        sets={NAMED: listed.prefixes(len(candidates.positions)), DESIGNED: tuple(designed)},
        limit_s=S_PER_MIN * max(listed.minutes[-1], _LONGEST_MIN),
        targets_um=tuple(targets),
        by_evidence=chosen.order == "evidence",
        seed=case.seed,
    )


@dataclass(frozen=True)
class _ListedSet:
    """Position set of the case with the machine minutes at the end of each position."""

    positions: tuple[Position, ...]
    minutes: tuple[float, ...]

    def prefixes(self, first: int) -> tuple[TimedSet, ...]:
        """Return the set and some of its beginnings. `first` is the index of its first position."""
        counts = [*range(_SET_STEP, len(self.positions), _SET_STEP), len(self.positions)]
        return tuple(TimedSet(tuple(range(first, first + count)), self.minutes[count - 1]) for count in counts)


def _listed_set(case: StudyCase) -> _ListedSet:
    held_out = set(case.job.held_out)
    listed = case.procedure.plan([one for one in case.positions() if one not in held_out]).positions
    minutes = machine_minutes(replace(case.job, positions=listed), listed)
    of_each = [minutes.per_position[position] for position in listed]
    # carrying is shared out evenly: the set is measured station by station
    ends = np.cumsum(of_each) + minutes.carrying * np.arange(1, len(of_each) + 1) / len(of_each)
    return _ListedSet(listed, tuple(ends.tolist()))


def _designed_sets(case: StudyCase, problems: Sequence[DesignProblem]) -> list[DesignResult]:
    """Return the best set for each slot, of those with all balls and with a share of them. Slots that are too short for
    two positions are left out. Raises InputError if all of them are."""
    case.progress("designs", 0, len(_SLOT_SHARES))
    designs, too_short = list[DesignResult](), InputError("no slot")
    for number, share in enumerate(_SLOT_SHARES, start=1):
        goal, found = TimeSlotGoal(share * _LONGEST_MIN), list[DesignResult]()
        for problem in problems:
            try:
                found.append(find_design(problem, goal, verify=False, prove=None, say=lambda _: None))
            except InputError as error:
                too_short = error
        if found:
            designs.append(min(found, key=lambda one: one.valuation.after.aligned_mm))
        case.progress("designs", number, len(_SLOT_SHARES))
    if not designs:
        raise too_short
    return designs


def _bounds(case: StudyCase, problems: Sequence[DesignProblem], minutes: Sequence[float]) -> list[InformationBound]:
    """Return the lower bound of the expected VCE for each of these machine times. The candidates are those of the
    designs, with all balls and with a share of them."""
    case.progress("information bound", 0, len(minutes))
    candidates = joined_candidates([problem.candidates for problem in problems])
    times = _shortest_minutes(case.job, candidates)
    bounds = list[InformationBound]()
    for number, one in enumerate(minutes, start=1):
        bounds.append(information_bound(candidates, times, one))
        case.progress("information bound", number, len(minutes))
    return bounds


def _shortest_minutes(job: Job, candidates: CandidatePositions) -> Array:
    """Return a time (N,) in min that the measurement of each candidate takes at least: without the turn of the mount
    and the way to its first ball.

    It is computed for some candidates; those of the others lie a little below the straight line over the number of
    balls below which none of the computed ones lies.
    """
    positions, timed = candidates.positions, timed_among(candidates.count)
    before = [
        next((one for one in positions if one.station == positions[index].station and one != positions[index]), None)
        for index in timed
    ]
    known = [(index, one) for index, one in zip(timed.tolist(), before, strict=True) if one is not None]
    indices = np.array([index for index, _ in known], dtype=np.intp)
    exact = np.array([minutes_at_balls(job, positions[index], one) for index, one in known])
    line = line_over_balls(candidates.balls, indices, exact)
    return np.asarray(_UNDERCUT * np.maximum(line + (exact - line[indices]).min(), exact.min()))


def _seconds(candidates: SequentialCandidates) -> Array:
    standing = [*(standing_in(position) for position in candidates.positions), None]
    return np.array([candidates.seconds(one, LEAST_CARRY_MIN) for one in standing])


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
    """Return the curve through the points that all machines have reached."""
    points = sorted({one.point for one in stated})
    every = [[one for one in stated if one.point == point] for point in points]
    of = [group for group in every if len(group) == len(every[0])]
    return VceCurve(
        name,
        tuple(round(float(np.mean([one.positions for one in group]))) for group in of),
        tuple(float(np.mean([one.minutes for one in group])) for group in of),
        tuple(float(np.sqrt(np.mean([one.true_um**2 for one in group]))) for group in of),
        tuple(float(np.mean([one.held for one in group])) for group in of),
    )
