"""Measuring procedures that decide the claims of the publication, and the volumetric errors that they leave.

Nothing is simulated. The residual field is linear in the machine, the artefact and the touches, so the errors of many
machines follow from one closed form. All procedures meet the same machines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.planning.case_file import load_case, shipped_case
from agent.planning.design.bar_variants import Bar
from agent.studies.identification_variants import PUBLISHED, IdentificationVariant
from agent.studies.measure import MEASURES, ErrorMeasure
from agent.studies.monte_carlo import with_stated_scales
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict, budget_if_identified
from agent.studies.study import StudyCase
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.position_set import SET_EXPRESSIONS
from twin.machine.machine_population import Family
from twin.uncertainty.work_frame import WorkFrameForm
from twin.units import UM_PER_MM

OTHER_CASES = ("bridge", "mill")
"""Shipped machines on which the claims are checked beside the machine of the case."""

REFERENCE_SET = "S3"
COUNTS = (3, 5, 7, 9, 11, 15)
STRAIGHT_DEG, TILTED_DEG = 0.0, 30.0
TILTED_SETS = ("S2", "S2+S3")


@dataclass(frozen=True)
class ProcedureKey:
    """Procedure by its position set and by what is varied: the number of balls or the tilt of their holders. None
    stands for the artefact as it is."""

    positions: str
    balls: int | None = None
    tilt_deg: float | None = None


KEYS = (
    *(ProcedureKey(REFERENCE_SET, balls=count) for count in COUNTS),
    *(ProcedureKey(name, tilt_deg=tilt) for name in TILTED_SETS for tilt in (STRAIGHT_DEG, TILTED_DEG)),
    *(ProcedureKey(name) for name in SET_EXPRESSIONS),
)


@dataclass(frozen=True, eq=False)
class RemainingErrors:
    """Volumetric errors in µm, keyed by `ErrorMeasure.key`: `expected_um` is the root of the mean square over machines
    in closed form, and `machines_um`, shape (m,), contains the error of each of m machines. `cost` is the number of
    ball centres that are measured, 0 without a procedure.
    """

    expected_um: Mapping[str, float]
    machines_um: Mapping[str, Array]
    cost: int = 0


@dataclass(frozen=True, eq=False)
class StudiedMachine:
    """Machine on which the claims are checked, with its procedures in the order of `KEYS`. A procedure is None if no
    position has three balls within reach."""

    name: str
    artefact: str
    family: Family
    work_frame: WorkFrameForm
    variants: tuple[IdentificationVariant, ...]
    trials: tuple[ProcedureVariant, ...]
    drawn: Array

    @classmethod
    def of(cls, case: StudyCase) -> StudiedMachine:
        bar, evaluator = Bar.of(case.artefact), ProcedureEvaluator(case)
        trials = []
        for key in KEYS:
            varied = key.balls is not None or key.tilt_deg is not None
            artefact = bar.with_(balls=key.balls, tilt_deg=key.tilt_deg) if varied else case.artefact
            trials.append(ProcedureVariant.of(case, artefact, case.positions(key.positions)))
        parameters = len(evaluator.field.true_indices)
        # uniform between ±√3: a standard deviation of 1
        drawn = generator(case.seed, 0).uniform(-math.sqrt(3.0), math.sqrt(3.0), (case.machines, parameters))
        variants = tuple(IdentificationVariant(with_stated_scales(one)) for one in (PUBLISHED, case.options))
        names = case.machine.name, case.artefact.name
        return cls(*names, case.machine.family, evaluator.work_frame, variants, tuple(trials), drawn)

    def uncompensated(self) -> RemainingErrors:
        field = self.work_frame.field
        parameters = np.zeros((len(self.drawn), field.size))
        parameters[:, field.true_indices] = self.drawn * field.assumptions.family.prior_standard_deviation
        before = Verdict(field.uncompensated(), in_work_frame_mm=self.work_frame.uncompensated_mm())
        return self._errors(before, parameters, 0)

    def compensated(self, variant: int, procedure: int, seed: int) -> RemainingErrors | None:
        """Return the errors after the procedure with this index in `KEYS`; None if it does not identify the machine."""
        trial, chosen, field = self.trials[procedure], self.variants[variant], self.work_frame.field
        budget = budget_if_identified(field, self.family, trial, chosen)
        if budget is None or trial.planned is None:
            return None
        left = Verdict(budget.expected, in_work_frame_mm=self.work_frame.expected_mm(budget))
        rng = generator(seed, 1 + procedure)
        return self._errors(left, budget.draw_residuals(self.drawn, rng), trial.planned.size)

    def _errors(self, verdict: Verdict, parameters: Array, cost: int) -> RemainingErrors:
        raw_mm, aligned_mm = self.work_frame.field.form.values(parameters)
        machines = zip(MEASURES, (raw_mm, self.work_frame.values_mm(parameters), aligned_mm), strict=True)
        return RemainingErrors(
            {measure.key: measure.um(verdict) or 0.0 for measure in MEASURES},
            {measure.key: UM_PER_MM * values for measure, values in machines},
            cost,
        )


@dataclass(frozen=True, eq=False)
class EvaluationTask:
    """Task that evaluates one procedure. It is called with the indices of machine, identification variant and
    procedure; the last is -1 for the machine without compensation."""

    machines: tuple[StudiedMachine, ...]
    seed: int

    def __call__(self, item: tuple[int, int, int]) -> RemainingErrors | None:
        machine, variant, procedure = item
        if procedure < 0:
            return self.machines[machine].uncompensated()
        return self.machines[machine].compensated(variant, procedure, self.seed)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Errors that the procedures leave on one machine in one reading of the method, in one measure."""

    machine: str
    artefact: str
    variant: IdentificationVariant
    measure: ErrorMeasure
    before: RemainingErrors
    after: Mapping[ProcedureKey, RemainingErrors | None]

    def expected(self, *keys: ProcedureKey) -> list[float | None]:
        """Return the expected errors in µm of the procedures `keys`; None if the machine is not identified."""
        found = [self.after[key] for key in keys]
        return [None if one is None else one.expected_um[self.measure.key] for one in found]

    def machines(self, *keys: ProcedureKey) -> Array | None:
        """Return the errors (keys, m) in µm of m machines; None if one of the procedures identifies nothing."""
        found = [self.after[key] for key in keys]
        if any(one is None for one in found):
            return None
        return np.array([one.machines_um[self.measure.key] for one in found if one is not None])

    def costs(self, *keys: ProcedureKey) -> list[int]:
        """Return the numbers of ball centres of the procedures `keys`."""
        return [0 if (one := self.after[key]) is None else one.cost for key in keys]

    @property
    def before_um(self) -> float:
        return self.before.expected_um[self.measure.key]

    @property
    def machines_before_um(self) -> Array:
        return self.before.machines_um[self.measure.key]


def studied_cases(case: StudyCase) -> list[StudyCase]:
    """Return the case and the other shipped machines with the same identification options, seed and workers."""
    others = [replace(case, job=load_case(shipped_case(name).settings), position_set=None) for name in OTHER_CASES]
    return [case, *(other for other in others if other.machine.name != case.machine.name)]


def evaluate(case: StudyCase) -> list[Outcomes]:
    """Return the outcomes of all procedures on all machines, in both readings and in all measures."""
    machines = tuple(StudiedMachine.of(one) for one in studied_cases(case))
    items = [(machine, 0, -1) for machine in range(len(machines))]
    items += [(m, v, p) for m in range(len(machines)) for v in range(2) for p in range(len(KEYS))]
    found = dict(zip(items, case.map(EvaluationTask(machines, case.seed), items, "procedures"), strict=True))
    return [
        Outcomes(one.name, one.artefact, variant, measure, _known(found[m, 0, -1]), _after(found, m, v))
        for m, one in enumerate(machines)
        for v, variant in enumerate(one.variants)
        for measure in MEASURES
    ]


def _after(
    found: Mapping[tuple[int, int, int], RemainingErrors | None], machine: int, variant: int
) -> dict[ProcedureKey, RemainingErrors | None]:
    return {key: found[machine, variant, number] for number, key in enumerate(KEYS)}


def _known(errors: RemainingErrors | None) -> RemainingErrors:
    if errors is None:
        raise ValueError("a machine without compensation always has an error")
    return errors


def bent(costs: Sequence[float], values: Sequence[float]) -> int:
    """Return the index of the procedure at the bend of the Pareto front of cost and error.

    The bend is the point of the front farthest below the straight line from its cheapest to its best point, with both
    axes scaled to the range of the front. Without a point below the line it is the best one.
    """
    order = sorted(range(len(costs)), key=lambda n: (costs[n], values[n]))
    front: list[int] = []
    for number in order:
        if not front or values[number] < values[front[-1]]:
            front.append(number)
    first, last = front[0], front[-1]
    if len(front) < 3:
        return last
    along = [(costs[n] - costs[first]) / (costs[last] - costs[first]) for n in front]
    down = [(values[n] - values[last]) / (values[first] - values[last]) for n in front]
    below = [1.0 - x - y for x, y in zip(along, down, strict=True)]
    best = max(range(len(front)), key=lambda n: below[n])
    return front[best] if below[best] > 0.0 else last
