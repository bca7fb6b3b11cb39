"""Study of how often the 95 % confidence regions of an estimate contain the true errors (coverage), for machines that
have more errors than the model describes.

Each machine is drawn with one of several forms of elastic deflection. It is measured in the position set of the study's
case and in the held-out positions. Two estimates are made: one with the Legendre order of the machine file, and one
with the order that has the largest evidence from the measurements.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from agent.studies.coverage_figure import LEVELS, Panel, draw
from agent.studies.study import StudyCase, StudyResult
from agent.studies.workers import generator
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification import Estimate, Options, identify, identify_by_evidence
from twin.machine.machine_description import MachineDescription
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.coverage import (
    FieldError,
    ObservedCoverage,
    held_out_levels,
    observed_coverage,
    parameter_levels,
    volumetric_comparisons,
)
from twin.uncertainty.random_machines import (
    AS_MODELLED,
    DEFLECTION_FORMS,
    THERMOMETER_UNCERTAINTY_K,
    RandomMachine,
    draw_random_machine,
)

NAME = "coverage"
NOMINAL = 0.95
ORDER_OF_FILE, ORDER_BY_EVIDENCE = "order of the file", "order by evidence"
REGIONS = ("field at points", "field jointly", "held-out position", "VE", "VCE")
PARAMETERS = "parameters"
_CANDIDATES = (5, 7, 9)
_POINTS, _JOINT = 100, 12
_GRID = (16, 8, 8)
_MEASURED_SHARE = 0.5  # uncertainty relative to the prior below which a parameter counts as measured
_MACHINES_PER_CHECK = 5  # number of richer machines per machine as modelled


@dataclass(frozen=True, eq=False)
class ComparedEstimate:
    """Comparison of one estimate with the true errors of its machine.

    `form` names the shape of the random elastic deflection of the machine, and `chosen` says how the Legendre
    order was chosen. `levels` maps each kind of confidence region to the confidence levels at which the regions just
    contain the true values. `ve_mm` is the true volumetric error without compensation (VE), `vce_mm` the true
    volumetric error after compensation (VCE) and `predicted_vce_mm` the VCE predicted by the estimate, all in mm.
    """

    form: str
    chosen: str
    order: int
    levels: dict[str, Array]
    ve_mm: float
    vce_mm: float
    predicted_vce_mm: float


@dataclass(frozen=True, eq=False)
class CoverageTask:
    """Task that draws a machine, given its number and the form of its elastic deflection, and compares its estimates
    with its true errors."""

    machine: MachineDescription
    artefact: Artefact
    planned: Observations
    held_out: Observations
    options: Options
    tool_offset: Array
    seed: int

    def __call__(self, item: tuple[int, str]) -> list[ComparedEstimate]:
        number, form = item
        rng = generator(self.seed, number)
        random_machine = draw_random_machine(self.machine, self.tool_offset, form, rng)
        both = self._measure_both(random_machine, rng)
        seen = both.select(np.arange(both.size) < self.planned.size)
        again = both.select(np.arange(both.size) >= self.planned.size)
        low, high = np.array(self.machine.model.ranges_mm).T
        points = rng.uniform(low, high, (_POINTS, 3))
        return [self._compared(random_machine, *found, again, points) for found in self._estimates(seen, form)]

    def _measure_both(self, random_machine: RandomMachine, rng: np.random.Generator) -> Observations:
        """Return simulated measurements of the set, then of the held-out positions. Both are made with the same
        artefact under the same conditions."""
        parts = (self.planned, self.held_out)
        further = replace(self.held_out, position=self.held_out.position + self.planned.position.max() + 1)
        rows = {
            name: np.concatenate([getattr(part, name) for part in (self.planned, further)])
            for name in ("position", "ball", "tool", "axis_positions", "covariance", "temperature_c", "elevation_rad")
        }
        return random_machine.measure(Observations(**rows, tool_offsets=parts[0].tool_offsets), self.artefact, rng)

    def _estimates(self, seen: Observations, form: str) -> Iterator[tuple[str, MachineDescription, Estimate]]:
        own = self.machine
        yield ORDER_OF_FILE, own, identify(own.model, seen, self.artefact, own.family, self.options)
        if form == AS_MODELLED or not self.options.use_prior:
            return
        orders = {order: own.with_order(order) for order in _CANDIDATES}
        best = identify_by_evidence(
            lambda order: orders[order].family, seen, self.artefact, self.options, candidates=_CANDIDATES
        )
        yield ORDER_BY_EVIDENCE, orders[max(best.model.highest_order)], best

    def _compared(
        self,
        random_machine: RandomMachine,
        chosen: str,
        machine: MachineDescription,
        estimate: Estimate,
        again: Observations,
        points: Array,
    ) -> ComparedEstimate:
        truth = random_machine.truth
        field = FieldError.of(estimate, truth, points)
        ve, vce = volumetric_comparisons(estimate, truth, evaluation_grid(machine.model.ranges_mm, _GRID))
        levels = {
            "field at points": field.pointwise_levels(),
            "field jointly": np.array([FieldError.of(estimate, truth, points[:_JOINT]).joint_level()]),
            "held-out position": held_out_levels(estimate, machine.family, again, self.artefact, self.options),
            "VE": np.array([ve.level]),
            "VCE": np.array([vce.level]),
        }
        if random_machine.form == AS_MODELLED:
            levels[PARAMETERS] = parameter_levels(estimate, truth.parameters, _MEASURED_SHARE)
        order = max(estimate.model.highest_order)
        return ComparedEstimate(random_machine.form, chosen, order, levels, ve.true_mm, vce.true_mm, vce.expected_mm)


def run(case: StudyCase) -> StudyResult:
    """Compute how often confidence regions contain the true errors (coverage), over `case.machines` machines with
    alternating forms of elastic deflection.

    Some additional machines are drawn that the model describes exactly.
    """
    machines = [(number, DEFLECTION_FORMS[number % len(DEFLECTION_FORMS)]) for number in range(case.machines)]
    machines += [(case.machines + extra, AS_MODELLED) for extra in range(max(case.machines // _MACHINES_PER_CHECK, 2))]
    found = case.map(_comparison(case), machines)
    every = [one for estimates in found for one in estimates]
    table = CoverageTable(every, generator(case.seed, len(machines)))
    return StudyResult(
        name=NAME,
        title="How often the 95 % regions of an estimate hold the truth",
        columns=COLUMNS,
        rows=[_row(number, one) for number, estimates in enumerate(found) for one in estimates],
        summary=_summary(table),
        draw=partial(draw, panels=_panels(table)),
        size_in=(10.0, 7.4),
    )


def _comparison(case: StudyCase) -> CoverageTask:
    procedure = case.procedure
    return CoverageTask(
        machine=case.machine,
        artefact=case.artefact,
        planned=procedure.plan(case.positions()).observations,
        held_out=procedure.plan(case.job.held_out).observations,
        options=replace(case.options, temperature_standard_uncertainty_k=THERMOMETER_UNCERTAINTY_K),
        tool_offset=case.tool_offset,
        seed=case.seed,
    )


@dataclass(frozen=True, eq=False)
class CoverageTable:
    """Comparisons of estimates with true errors for all machines. The observed coverage can be computed for any
    selection of these comparisons."""

    compared: Sequence[ComparedEstimate]
    rng: np.random.Generator

    def select(self, chosen: str, form: str | None = None) -> list[ComparedEstimate]:
        """Return the comparisons in which the Legendre order was chosen by the method `chosen` and the deflection of
        the machine has the shape `form`. If `form` is None, return those for all shapes."""
        forms = DEFLECTION_FORMS if form is None else (form,)
        return [one for one in self.compared if one.chosen == chosen and one.form in forms]

    def coverage(
        self, comparisons: Sequence[ComparedEstimate], region: str, nominal: float = NOMINAL
    ) -> ObservedCoverage:
        return observed_coverage([one.levels[region] for one in comparisons], nominal, self.rng)

    @property
    def order_choices(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(one.chosen for one in self.compared))


COLUMNS = (
    "machine",
    "form",
    "estimate",
    "order",
    "ve_true_aligned_um",
    "vce_true_aligned_um",
    "vce_predicted_aligned_um",
    "field_at_points_share_held",
    "field_jointly_level",
    "held_out_share_held",
    "ve_level",
    "vce_level",
    "parameters_share_held",
)


def _row(number: int, one: ComparedEstimate) -> tuple[str | int | float | None, ...]:
    held = {region: float(np.mean(levels <= NOMINAL)) for region, levels in one.levels.items()}
    level = {region: float(levels[0]) for region, levels in one.levels.items()}
    return (
        number,
        one.form,
        one.chosen,
        one.order,
        1e3 * one.ve_mm,
        1e3 * one.vce_mm,
        1e3 * one.predicted_vce_mm,
        held["field at points"],
        level["field jointly"],
        held["held-out position"],
        level["VE"],
        level["VCE"],
        held.get(PARAMETERS),
    )


def _summary(table: CoverageTable) -> dict[str, object]:
    summary: dict[str, object] = {"forms": list(DEFLECTION_FORMS), "nominal": NOMINAL}
    for choice in table.order_choices:
        every = table.select(choice)
        shares = _shares(table, every)
        summary[choice] = {
            **{region: share.observed for region, share in shares.items()},
            "standard_errors": _rounded([share.standard_error for share in shares.values()]),
            "predicted_over_true_vce": _ratio(every),
            "by_form": {
                form: _pairs(table, table.select(choice, form))
                for form in DEFLECTION_FORMS
                if table.select(choice, form)
            },
        }
    summary["as_modelled"] = _pairs(table, table.select(ORDER_OF_FILE, AS_MODELLED))
    return summary


def _shares(table: CoverageTable, of: Sequence[ComparedEstimate]) -> dict[str, ObservedCoverage]:
    return {region: table.coverage(of, region) for region in of[0].levels}


def _pairs(table: CoverageTable, of: Sequence[ComparedEstimate]) -> dict[str, list[float]]:
    """Return region → observed coverage and its standard error."""
    shares = _shares(table, of)
    return {region: _rounded([share.observed, share.standard_error]) for region, share in shares.items()}


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 4) for value in values]


def _ratio(of: Sequence[ComparedEstimate]) -> dict[str, float]:
    ratios = np.array([one.predicted_vce_mm / one.vce_mm for one in of])
    return {
        "mean": round(float(ratios.mean()), 4),
        "mean_departure_from_1": round(float(np.abs(ratios - 1.0).mean()), 4),
        "of_root_mean_squares": round(_rms([o.predicted_vce_mm for o in of]) / _rms([o.vce_mm for o in of]), 4),
    }


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _panels(table: CoverageTable) -> list[Panel]:
    panels = []
    for choice in table.order_choices:
        groups = {form: table.select(choice, form) for form in DEFLECTION_FORMS if table.select(choice, form)} | {
            "all": table.select(choice)
        }
        shares = {region: [table.coverage(of, region) for of in groups.values()] for region in REGIONS}
        curves = {
            region: np.array([table.coverage(table.select(choice), region, level).observed for level in LEVELS])
            for region in REGIONS
        }
        panels.append(Panel(choice, tuple(groups), shares, curves))
    return panels
