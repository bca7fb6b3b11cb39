"""Study that compares designed position sets with S1, S2, S3 and their combinations, by volumetric compensated error
(VCE) and machine time.

Every set is evaluated by the closed form for whole procedures (`twin.uncertainty.error_budget`). This closed form
includes the deflection stated in the machine file; the error model and the search for designs do not include the
deflection. The named sets are also evaluated with the published method as read here (see
`agent.studies.identification_variants`), and with distances of unit weights and the family as prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, INK, ORANGE, PURPLE, from_zero
from agent.planning.cycle_time import machine_minutes, set_alone
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.design_result import Prove, find_design
from agent.planning.design.set_valuation import valuation_of
from agent.planning.design.variants import Variant, variants_of
from agent.planning.job import Job
from agent.studies.identification_variants import PUBLISHED, UNWEIGHTED, IdentificationVariant
from agent.studies.monte_carlo import with_stated_scales
from agent.studies.study import Cell, StudyCase, StudyResult
from twin.artefact.position_set import Position
from twin.design.goals import Goal, TargetErrorGoal, TimeSlotGoal
from twin.identification import Options
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.error_budget import error_budget_of_form
from twin.uncertainty.residual_field_form import FieldForm

Item = TypeVar("Item")

NAME = "design"
GRID_DEG = 15.0
SETS = ("S1", "S2", "S3", "S1+S2", "S1+S3", "S2+S3", "S1+S2+S3")
REFERENCE = "S3"
SLOT_SHARES = (0.125, 0.1875, 0.25, 0.375, 0.5, 0.75, 1.0)
"""Time slots, as shares of the machine time of the reference set."""
VARIANT_SHARE = 0.5
"""Time slot for which variants of artefact and touches are designed, as a share of the reference set's machine time."""
TOUCHES, BALLS, THETAS_DEG = (5, 9, 13), (5, 7, 9, 15), (0.0, 5.0, 30.0)
SLOT_KIND, TARGET_KIND = "design for a slot", "design for a target"
COLUMNS = (
    "set",
    "kind",
    "touches_per_ball",
    "artefact_balls",
    "theta_deg",
    "positions",
    "balls",
    "machine_minutes",
    "criterion_vce_um",
    "vce_um",
    "published_vce_um",
    "distances_with_prior_vce_um",
    "valuation_percent",
)
CENTRES, PUBLISHED_METHOD, DISTANCES = (
    IdentificationVariant(with_stated_scales(options))
    for options in (Options(), PUBLISHED, replace(UNWEIGHTED, use_prior=True))
)


@dataclass(frozen=True)
class EvaluatedSet:
    """Results of one position set. All errors are computed after the best-fitting rigid motion is removed.

    `criterion_um` is the expected volumetric compensated error (VCE) without the elastic deflection of the machine,
    which is the criterion of the search for designed sets. `vce_um` is the expected VCE with deflection. `published_um`
    is the expected VCE with the published method, and `distances_um` that with distances between balls, equal weights
    and the machine family as prior; both are None for a designed set.
    """

    name: str
    kind: str
    touches: int
    artefact_balls: int
    theta_deg: float | None
    positions: int
    balls: int
    minutes: float
    criterion_um: float
    vce_um: float
    published_um: float | None
    distances_um: float | None
    valuation: float


def run(case: StudyCase) -> StudyResult:
    """Evaluate three groups of position sets.

    The first group contains the named sets (S1, S2, S3 and their combinations). The second contains the designs for
    several time slots, and the design that reaches the volumetric compensated error (VCE) of the reference set S3. The
    third contains the designs for one time slot with different artefacts and numbers of touches.
    """
    evaluator = SetEvaluator.of(case)
    base = variants_of(case.job, Path())[0]
    named = [evaluator.evaluate_named(base, name, case.positions(name)) for name in SETS]
    reference = next(one for one in named if one.name == REFERENCE)
    goals: list[tuple[str, Goal]] = [(SLOT_KIND, TimeSlotGoal(share * reference.minutes)) for share in SLOT_SHARES]
    goals.append((TARGET_KIND, TargetErrorGoal(1e-3 * reference.criterion_um)))
    problem = DesignProblem(base.jobs, GRID_DEG, set_alone)
    designs = [
        evaluator.evaluate_design(base, problem, goal, kind=kind, prove=case.prove)
        for kind, goal in _counted(case, goals, "designs")
    ]
    slot = TimeSlotGoal(VARIANT_SHARE * reference.minutes)
    options = _counted(case, _options(case.job), "artefacts and touches")
    variants = [
        evaluator.evaluate_design(
            variant, DesignProblem(variant.jobs, GRID_DEG, set_alone), slot, kind="variant", prove=None
        )
        for variant in options
    ]
    evaluated = [*named, *designs, *variants]
    return StudyResult(
        name=NAME,
        title="Designed position sets against S1, S2, S3",
        columns=COLUMNS,
        rows=[_row(one) for one in evaluated],
        summary=_summary(evaluator, named, designs),
        draw=partial(_draw, named=named, designs=designs, variants=variants, before_um=evaluator.before_um),
        size_in=(10.5, 4.6),
    )


@dataclass(frozen=True, eq=False)
class SetEvaluator:
    """Evaluator of position sets. `field` is the quadratic form that gives the mean square of the residual error field
    on the evaluation grid of the workspace; it is the same for all sets."""

    field: FieldForm

    @classmethod
    def of(cls, case: StudyCase) -> SetEvaluator:
        grid = evaluation_grid(case.machine.model.ranges_mm)
        return cls(FieldForm.build(case.machine.model, case.assumptions, grid, case.tool_offset))

    @property
    def before_um(self) -> float:
        return self.field.uncompensated().aligned_um

    def evaluate_named(self, variant: Variant, name: str, positions: Sequence[Position]) -> EvaluatedSet:
        minutes = machine_minutes(_job(variant), positions).total
        return self._evaluated(name, "named", variant, positions, minutes, published=True)

    def evaluate_design(
        self, variant: Variant, problem: DesignProblem, goal: Goal, *, kind: str, prove: Prove | None
    ) -> EvaluatedSet:
        found = find_design(problem, goal, verify=False, prove=prove, say=lambda _: None)
        return self._evaluated(
            f"{len(found.positions)} designed", kind, variant, found.positions, found.minutes, published=False
        )

    def _evaluated(
        self, name: str, kind: str, variant: Variant, positions: Sequence[Position], minutes: float, *, published: bool
    ) -> EvaluatedSet:
        job = _job(variant)
        planned = job.procedure.plan(positions)
        worth = valuation_of(job, positions)

        def expected_um(variant: IdentificationVariant) -> float:
            field = replace(self.field, assumptions=variant.assumptions(self.field.assumptions))
            seen, options = planned.observations, variant.options
            return error_budget_of_form(field, job.machine.family, job.artefact, seen, options).expected.aligned_um

        return EvaluatedSet(
            name=name,
            kind=kind,
            touches=variant.touches,
            artefact_balls=variant.balls,
            theta_deg=variant.theta_deg,
            positions=len(planned.positions),
            balls=planned.observations.size,
            minutes=minutes,
            criterion_um=worth.after.aligned_um,
            vce_um=expected_um(CENTRES),
            published_um=expected_um(PUBLISHED_METHOD) if published else None,
            distances_um=expected_um(DISTANCES) if published else None,
            valuation=worth.percent,
        )


def _job(variant: Variant) -> Job:
    return next(iter(variant.jobs.values()))


def _options(job: Job) -> list[Variant]:
    """Return measuring variants, each of which differs from the job in the touches, the number of balls or the tilt of
    the holders."""
    choices: list[dict[str, Sequence[int] | Sequence[float]]] = [
        {"touches": TOUCHES},
        {"balls": BALLS},
        {"thetas_deg": THETAS_DEG},
    ]
    return [variant for choice in choices for variant in variants_of(job, Path(), **choice)]  # type: ignore[arg-type]


def _counted(case: StudyCase, items: Sequence[Item], what: str) -> Iterator[Item]:
    for done, item in enumerate(items):
        case.progress(what, done, len(items))
        yield item
    case.progress(what, len(items), len(items))


def _row(one: EvaluatedSet) -> list[Cell]:
    return [getattr(one, field.name) for field in fields(EvaluatedSet)]


def _summary(
    evaluator: SetEvaluator, named: Sequence[EvaluatedSet], designs: Sequence[EvaluatedSet]
) -> dict[str, object]:
    """Return the VCE of the reference set by each formulation, and the share of its machine time in which a design
    reaches that VCE."""
    reference = next(one for one in named if one.name == REFERENCE)
    rivals = {
        "reference": reference.vce_um,
        "published": reference.published_um or evaluator.before_um,
        "distances_with_prior": reference.distances_um or evaluator.before_um,
    }
    return {
        "set": REFERENCE,
        "ve_um": evaluator.before_um,
        "reference_minutes": reference.minutes,
        **{f"{name}_vce_um": vce_um for name, vce_um in rivals.items()},
        **{f"share_of_time_to_{name}": _share(designs, vce_um, reference) for name, vce_um in rivals.items()},
    }


def _share(designs: Sequence[EvaluatedSet], vce_um: float, reference: EvaluatedSet) -> float | None:
    """Return the machine time of the fastest design with at most `vce_um`, as a share of the reference set's; None if
    no design reaches it."""
    soonest = min((one.minutes for one in designs if one.vce_um <= vce_um), default=None)
    return None if soonest is None else soonest / reference.minutes


def _draw(
    figure: Figure,
    named: Sequence[EvaluatedSet],
    designs: Sequence[EvaluatedSet],
    variants: Sequence[EvaluatedSet],
    before_um: float,
) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_sets(left, named, designs, before_um)
    _draw_variants(right, variants)


def _draw_sets(axes: Axes, named: Sequence[EvaluatedSet], designs: Sequence[EvaluatedSet], before_um: float) -> None:
    line = sorted((one for one in designs if one.kind == SLOT_KIND), key=lambda one: one.minutes)
    axes.plot(
        [one.minutes for one in designs if one.kind != SLOT_KIND],
        [one.vce_um for one in designs if one.kind != SLOT_KIND],
        "s",
        color=BLUE,
        fillstyle="none",
        markersize=9,
        label=f"designed for the expected VCE of {REFERENCE}",
    )
    axes.plot([one.minutes for one in line], [one.vce_um for one in line], "-o", color=BLUE, label="designed")
    for one in line:
        axes.annotate(str(one.positions), (one.minutes, one.vce_um), (4, 4), textcoords="offset points", color=BLUE)
    axes.plot(
        [one.minutes for one in named], [one.vce_um for one in named], "D", color=GREEN, label="named sets, centres"
    )
    for one in named:
        axes.annotate(one.name, (one.minutes, one.vce_um), (4, 4), textcoords="offset points", fontsize=8)
    for values, marker, colour, label in (
        ([one.published_um for one in named], "^", PURPLE, "named sets, published method as read"),
        ([one.distances_um for one in named], "v", ORANGE, "named sets, distances, unit weights, prior"),
    ):
        axes.plot([one.minutes for one in named], [v or 0.0 for v in values], marker, color=colour, label=label)
    axes.axhline(before_um, color=INK, linewidth=0.8, linestyle=":", label="without compensation")
    axes.set_xlabel("machine time / min")
    axes.set_xlim(0.0, 1.15 * max(one.minutes for one in (*named, *designs)))
    axes.set_title("Designed sets (numbers: positions) against S1, S2, S3")
    from_zero(axes, "expected VCE, rigidly aligned / µm")
    axes.set_ylim(top=1.45 * before_um)
    axes.legend(loc="upper right")


def _draw_variants(axes: Axes, variants: Sequence[EvaluatedSet]) -> None:
    names = [_variant_name(one) for one in variants]
    coordinates = list(range(len(variants)))[::-1]
    axes.barh(coordinates, [one.vce_um for one in variants], color=PURPLE, height=0.6)
    for coordinate, one in zip(coordinates, variants, strict=True):
        axes.annotate(
            f"{one.vce_um:.2f} ({one.positions} positions)",
            (one.vce_um, coordinate),
            (-4, -3),
            textcoords="offset points",
            ha="right",
            fontsize=8,
        )
    axes.set_yticks(coordinates, names)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("expected VCE, rigidly aligned / µm")
    axes.set_title(f"Designs for {VARIANT_SHARE:.0%} of {REFERENCE}'s time")


def _variant_name(one: EvaluatedSet) -> str:
    tilt = "" if one.theta_deg is None else f", θ {one.theta_deg:.3g}°"
    return f"{one.touches} touches, {one.artefact_balls} balls{tilt}"
