"""Volumetric error that remains after the machine errors have been measured with a given procedure and compensated. The
error is computed in closed form, and also simulated on many machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from agent.studies.identification_variants import IdentificationVariant
from agent.studies.monte_carlo import ErrorSample, Outcome, ProcedureTask, mostly_refused, refused
from agent.studies.study import StudyCase
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.errors import DataError, SingularSet
from twin.identification import identify
from twin.machine.anchor import Anchor
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.uncertainty.error_budget import ErrorBudget, error_budget_of_form
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.work_frame import WorkFrameForm

MIN_MACHINES = 2
"""Minimum number of machines for a standard error."""


@dataclass(frozen=True, eq=False)
class ProcedureVariant:
    """Measuring procedure, given by an artefact and the observations planned with it. `planned` is None if the artefact
    has no position with at least three balls within reach of the machine.
    """

    artefact: Artefact
    planned: Observations | None

    @classmethod
    def of(cls, case: StudyCase, artefact: Artefact, positions: Sequence[Position]) -> ProcedureVariant:
        procedure = case.procedure.with_artefact(artefact)
        try:
            return cls(artefact, procedure.plan(positions).observations)
        except DataError:
            return cls(artefact, None)


@dataclass(frozen=True)
class Verdict:
    """Volumetric error after compensation (VCE) that one measuring procedure achieves, if the machine is identified
    with one variant of the identification options.

    `expected` is the square root of the expected mean square VCE, computed in closed form. It is None if the
    measurements do not identify the machine. `simulated` is the rms VCE of `machines` simulated machines, and
    `standard_error` is the standard error of this rms value. `simulated` and `standard_error` are None if the procedure
    was not simulated, or if the identification refuses more than half of the machines. `refused` is the number of
    further machines that it refuses because their measurements contradict. `in_work_frame_mm` is the counterpart of
    `expected` for a workpiece that is set up in the middle of the travel (`twin.uncertainty.work_frame`); it is None if
    that was not computed or if `expected` is None.
    """

    expected: VolumetricRms | None
    simulated: VolumetricRms | None = None
    standard_error: VolumetricRms | None = None
    machines: int = 0
    in_work_frame_mm: float | None = None
    refused: int = 0

    def with_simulation(self, field: FieldForm, machines: Sequence[Outcome]) -> Verdict:
        """Return the verdict with the results of the simulated `machines` added, whose volumetric error after
        compensation (VCE) is computed with `field`.

        If the measurements of one of the machines do not determine its errors, the result is a verdict "not
        identified", whose `expected` is None.
        """
        if any(machine.undetermined for machine in refused(machines)):
            return Verdict(None)
        if mostly_refused(machines):
            return replace(self, refused=len(refused(machines)))
        spread = ErrorSample.compensated(field, machines)
        return replace(
            self,
            simulated=spread.expected,
            standard_error=spread.standard_error,
            machines=len(spread.raw_mm),
            refused=spread.refused,
        )


@dataclass(frozen=True, eq=False)
class ProcedureEvaluator:
    """Evaluator of measuring procedures for one study case. It computes the volumetric error that remains after the
    compensation, for several variants of the identification options.
    """

    case: StudyCase

    @cached_property
    def field(self) -> FieldForm:
        """Quadratic form that gives the mean square, over a grid of the workspace, of the error that remains after
        compensation. It depends on neither the measuring procedure nor the identification options, so it is built only
        once.
        """
        case = self.case
        grid = evaluation_grid(case.machine.model.ranges_mm)
        return FieldForm.build(case.machine.model, case.assumptions, grid, case.tool_offset)

    @cached_property
    def work_frame(self) -> WorkFrameForm:
        """The same for a workpiece that is zeroed in the middle of the travel and aligned along X and Y."""
        middle = [0.5 * (low + high) for low, high in self.case.machine.model.ranges_mm]
        return WorkFrameForm.aligned_by(self.field, Anchor(np.array(middle)))

    @cached_property
    def before(self) -> Verdict:
        """Expected volumetric error (VE) without compensation. It is the square root of the expected mean square VE."""
        return Verdict(self.field.uncompensated(), in_work_frame_mm=self.work_frame.uncompensated_mm())

    def budget(self, trial: ProcedureVariant, variant: IdentificationVariant) -> ErrorBudget | None:
        """Return the error budget, in closed form, of the measuring procedure `trial` with the identification options
        of `variant`. Return None if the planned observations do not identify the machine.
        """
        return budget_if_identified(self.field, self.case.machine.family, trial, variant)

    def evaluate(
        self, trials: Sequence[ProcedureVariant], variants: Sequence[IdentificationVariant], simulated: Sequence[int]
    ) -> list[tuple[Verdict, ...]]:
        """Return a table with one row per measuring procedure in `trials` and one column per identification variant in
        `variants`. Each element is a verdict, which contains the volumetric error that remains after compensation.

        The procedures whose indices are in `simulated` are also simulated, all on the same machines. The number of
        these machines is the number of machines of the study case divided by the number of simulated procedures, but at
        least two (`MIN_MACHINES`).
        """
        rows = []
        for number, trial in enumerate(trials):
            self.case.progress("closed form", number, len(trials))
            rows.append([self._expected(trial, variant) for variant in variants])
        self.case.progress("closed form", len(trials), len(trials))
        pairs = [
            (row, variant)
            for row in simulated
            for variant in range(len(variants))
            if rows[row][variant].expected is not None
        ]
        share = max(self.case.machines // max(len(simulated), 1), MIN_MACHINES)
        for (row, variant), machines in zip(pairs, self._simulated(trials, variants, pairs, share), strict=True):
            rows[row][variant] = rows[row][variant].with_simulation(self.field, machines)
        return [tuple(row) for row in rows]

    def _expected(self, trial: ProcedureVariant, variant: IdentificationVariant) -> Verdict:
        budget = self.budget(trial, variant)
        if budget is None:
            return Verdict(None)
        return Verdict(budget.expected, in_work_frame_mm=self.work_frame.expected_mm(budget))

    def _simulated(
        self,
        trials: Sequence[ProcedureVariant],
        variants: Sequence[IdentificationVariant],
        pairs: Sequence[tuple[int, int]],
        share: int,
    ) -> list[list[Outcome]]:
        """Return `share` simulated machines for each (trial, variant) pair."""
        if not pairs:
            return []
        tasks = tuple(self.procedure(trials[row], variants[variant]) for row, variant in pairs)
        items = [(task, machine) for task in range(len(tasks)) for machine in range(share)]
        found = self.case.map(_ProcedureOnMachine(tasks), items, "simulated machines")
        return [found[start : start + share] for start in range(0, len(found), share)]

    def procedure(self, trial: ProcedureVariant, variant: IdentificationVariant) -> ProcedureTask:
        """Return a task that simulates the procedure `trial` on one machine. The task is called with the number of the
        machine. Raises DataError if there is no position with at least three balls within reach.
        """
        if trial.planned is None:
            raise DataError("none of the positions has three balls within reach")
        case = self.case
        return ProcedureTask(
            planned=trial.planned,
            artefact=trial.artefact,
            family=case.machine.family,
            assumptions=variant.assumptions(case.assumptions),
            options=variant.options,
            tool_offset=case.tool_offset,
            seed=case.seed,
        )


def budget_if_identified(
    field: FieldForm, family: Family, trial: ProcedureVariant, variant: IdentificationVariant
) -> ErrorBudget | None:
    """Return the error budget, in closed form, of the measuring procedure `trial` on machines with the residual field
    `field` and the prior `family`. Return None if the planned observations do not identify the machine."""
    options = variant.options
    if trial.planned is None:
        return None
    stated = replace(field, assumptions=variant.assumptions(field.assumptions))
    try:
        # A prior or a cut-off determines every parameter; without one, only the identification tells.
        if not options.use_prior and options.cut_off is None:
            identify(family.model, trial.planned, trial.artefact, family, options)
        return error_budget_of_form(stated, family, trial.artefact, trial.planned, options)
    except SingularSet:
        return None


@dataclass(frozen=True, eq=False)
class _ProcedureOnMachine:
    """Task that simulates one of several procedures on one machine, given the procedure's index and the machine's
    number. A position set that barely identifies the nominal machine may fail to identify some of the simulated
    machines."""

    procedures: tuple[ProcedureTask, ...]

    def __call__(self, item: tuple[int, int]) -> Outcome:
        procedure, machine = item
        return self.procedures[procedure](machine)
