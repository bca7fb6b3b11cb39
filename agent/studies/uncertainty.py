"""Sources of the error that remains after compensation. The contribution of each source is computed in closed form, and
is also simulated separately.

The assumed conditions are not ideal. The artefact is warm, its thermometer has an error, and the machine drifts during
each position. The simulated machines have the deflection of the machine file, and higher Legendre orders than the
identified model. The identification takes the thermometer error into account, but not the drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from agent.studies.monte_carlo import ErrorSample, ProcedureTask, check_refusals, deviation, with_stated_scales
from agent.studies.study import StudyCase, StudyResult
from agent.studies.uncertainty_figure import InfluenceResult, UncertaintyResult, draw
from twin.artefact.observations import Observations
from twin.identification import Options
from twin.machine.error_model import ErrorModel
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import Family, family_from_amplitudes
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.uncertainty.error_budget import (
    CERTIFICATE,
    CTE,
    DRIFT,
    INFLUENCES,
    MISFIT,
    TEMPERATURE,
    TOUCH_NOISE,
    UNSEEN,
    ErrorBudget,
    error_budget_of_form,
)
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions
from twin.units import UM_PER_MM

NAME = "uncertainty"
TOGETHER = "all together"

ORDERS_BEYOND = 2
"""Legendre order of the true machines minus that of the model, as in the simulator of the case study."""

WARMER_K = 3.0
"""Temperature difference, in K, of the artefact from the reference temperature of its certificate."""

THERMOMETER_K = 0.1
DRIFT_MM = 0.5e-3

COLUMNS = (
    "influence",
    "raw_um",
    "aligned_um",
    "share_of_aligned_square_percent",
    "simulated_raw_um",
    "simulated_aligned_um",
    "standard_error_raw_um",
    "standard_error_aligned_um",
)


def run(case: StudyCase) -> StudyResult:
    """Compute the contributions of all influences, such as touch noise and drift, to the error that remains after
    compensation. The measurement is that of the position set of the study case. Also simulate each influence alone, and
    all influences together, on `case.machines` machines.
    """
    trial = _Trial.of(case)
    assumptions = study_assumptions(case)
    budget = trial.budget(assumptions)
    ProcedureTask.of(case, trial.planned, trial.options).check()
    together = trial.simulated(assumptions, TOGETHER)
    parts = [
        InfluenceResult(name, budget.contributions[name], None if alone is None else trial.simulated(alone, name))
        for name, alone in isolated_influences(assumptions, case.machine.model).items()
    ]
    return StudyResult(
        name=NAME,
        title="Where the error that compensation leaves comes from",
        columns=COLUMNS,
        rows=[_row(one, budget.expected) for one in (*parts, InfluenceResult(TOGETHER, budget.expected, together))],
        summary=_conditions(assumptions, trial.planned.size) | _figures(budget, together),
        draw=partial(draw, found=UncertaintyResult(tuple(parts), budget, together)),
        size_in=(11.0, 7.0),
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """Planned measurement of the position set of the case, and the identification options. The options use scales as
    stated and include the uncertainty of the thermometer."""

    case: StudyCase
    planned: Observations
    options: Options

    @classmethod
    def of(cls, case: StudyCase) -> _Trial:
        planned = case.procedure.plan(case.positions()).observations
        return cls(
            case, planned, replace(with_stated_scales(case.options), temperature_standard_uncertainty_k=THERMOMETER_K)
        )

    def form(self, assumptions: TruthAssumptions) -> FieldForm:
        model = self.case.machine.model
        return FieldForm.build(model, assumptions, evaluation_grid(model.ranges_mm), self.case.tool_offset)

    def budget(self, assumptions: TruthAssumptions) -> ErrorBudget:
        case = self.case
        return error_budget_of_form(
            self.form(assumptions), case.machine.family, case.artefact, self.planned, self.options
        )

    def simulated(self, assumptions: TruthAssumptions, what: str) -> ErrorSample:
        """Return the VCE of the case's machines, drawn under `assumptions`. `what`: label of the progress. Raises
        RunError if the identification refuses more than half of them."""
        task = replace(ProcedureTask.of(self.case, self.planned, self.options), assumptions=assumptions)
        machines = self.case.map(task, range(self.case.machines), what)
        check_refusals(self.case, machines)
        return ErrorSample.compensated(self.form(assumptions), machines)


def study_assumptions(case: StudyCase) -> TruthAssumptions:
    """Return the assumptions of the study `uncertainty` about the true conditions of the measurement, such as a warm
    artefact, a thermometer error and a drift of the machine.
    """
    true_machine = case.true_machine or case.machine
    usual = TruthAssumptions(
        family=extended_family(true_machine),
        deflection=true_machine.deflection,
        artefact_temperature_c=case.artefact.reference_temperature_c + WARMER_K,
        thermometer_uncertainty_k=THERMOMETER_K,
        drift_mm=DRIFT_MM,
    )
    return case.with_stated_effects(usual)


def extended_family(machine: MachineDescription) -> Family:
    """Return the family of machines (distribution of machine errors) described in the machine file, extended to higher
    Legendre orders. The amplitudes of the higher orders decrease as the machine file specifies.
    """
    model = machine.model
    orders = {error: order + ORDERS_BEYOND for error, order in model.orders.items()}
    richer = model.with_orders(orders)
    return family_from_amplitudes(richer, machine.amplitudes)


def isolated_influences(assumptions: TruthAssumptions, model: ErrorModel) -> Mapping[str, TruthAssumptions | None]:
    """Return a mapping from the name of each influence on the measurement (such as touch noise or drift) to assumptions
    in which only this influence is present.

    The value for the influence of the mount is None. The pose of the mount is free in every estimate, so this influence
    need not be simulated.
    """
    family = assumptions.family
    own = np.isin(family.model.names, model.names)
    nothing = TruthAssumptions(
        family=_part(family, np.zeros_like(own)),
        touch_noise=False,
        certificate=False,
        cte=False,
        artefact_temperature_c=assumptions.artefact_temperature_c,
    )
    alone = {
        TOUCH_NOISE: replace(nothing, touch_noise=True),
        CERTIFICATE: replace(nothing, certificate=True),
        CTE: replace(nothing, cte=True),
        TEMPERATURE: replace(nothing, thermometer_uncertainty_k=assumptions.thermometer_uncertainty_k),
        DRIFT: replace(nothing, drift_mm=assumptions.drift_mm),
        MISFIT: replace(nothing, family=_part(family, ~own), deflection=assumptions.deflection),
        UNSEEN: replace(nothing, family=_part(family, own)),
    }
    effects = {effect.name: replace(nothing, effects=(effect,)) for effect in assumptions.effects}
    return {name: alone.get(name) for name in INFLUENCES} | effects


def _part(family: Family, kept: np.ndarray[Any, np.dtype[np.bool_]]) -> Family:
    return Family(family.model, family.half_widths * kept)


def _row(one: InfluenceResult, expected: VolumetricRms) -> list[str | float | None]:
    share = 100.0 * (one.closed.aligned_mm / expected.aligned_mm) ** 2
    row: list[str | float | None] = [one.name, one.closed.raw_um, one.closed.aligned_um, share]
    if one.simulated is None:
        return [*row, None, None, None, None]
    mean, error = one.simulated.expected, one.simulated.standard_error
    return [*row, mean.raw_um, mean.aligned_um, error.raw_um, error.aligned_um]


def _conditions(assumptions: TruthAssumptions, balls: int) -> dict[str, object]:
    return {
        "balls_measured": balls,
        "true_orders_beyond_the_model": ORDERS_BEYOND,
        "artefact_temperature_c": assumptions.artefact_temperature_c,
        "thermometer_uncertainty_k": assumptions.thermometer_uncertainty_k,
        "drift_um": UM_PER_MM * assumptions.drift_mm,
    }


def _figures(budget: ErrorBudget, together: ErrorSample) -> dict[str, object]:
    expected, spread, error = budget.expected, together.expected, together.standard_error
    (low, high), median = budget.distribution.limits(), budget.distribution.median
    inside = (together.aligned_mm >= low.aligned_mm) & (together.aligned_mm <= high.aligned_mm)
    return {
        "machines_refused": together.refused,
        "ve_expected_aligned_um": budget.uncompensated.aligned_um,
        "vce_expected_raw_um": expected.raw_um,
        "vce_expected_aligned_um": expected.aligned_um,
        "vce_simulated_raw_um": spread.raw_um,
        "vce_simulated_aligned_um": spread.aligned_um,
        "vce_median_aligned_um": median.aligned_um,
        "vce_simulated_median_aligned_um": UM_PER_MM * float(np.median(together.aligned_mm)),
        "vce_95_percent_limits_aligned_um": [low.aligned_um, high.aligned_um],
        "simulated_inside_the_limits_percent": 100.0 * float(np.mean(inside)),
        "deviation_in_standard_errors": {
            "raw": deviation(spread.raw_mm, expected.raw_mm, error.raw_mm),
            "aligned": deviation(spread.aligned_mm, expected.aligned_mm, error.aligned_mm),
        },
        "contributions_aligned_um": {name: part.aligned_um for name, part in budget.contributions.items()},
    }
