"""Choice of position sets. The study evaluates the named sets S1, S2, S3 of artefact positions and all their
combinations. It compares the volumetric error after compensation (VCE) and the machine time of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import MARKERS, SERIES, from_zero
from agent.planning.cycle_time import machine_minutes
from agent.planning.job import Job
from agent.settings.schema import RELOCATION_BY_CRANE_MINUTES, RELOCATION_BY_HAND_MINUTES
from agent.studies.identification_variants import IdentificationVariant, identification_variants
from agent.studies.measure import ALIGNED, AS_DEFINED, MEASURES, ErrorMeasure, values_before
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import Cell, StudyCase, StudyResult
from agent.studies.verdict_figure import BrokenAxes, draw_legend
from agent.studies.verdict_table import COLUMNS, cells, refused_machines, worst_deviation
from twin.artefact.position_set import POSITION_SETS, SET_EXPRESSIONS, Position
from twin.uncertainty.work_frame import WorkFrameForm
from twin.units import UM_PER_MM

NAME = "strategy"
PUBLISHED_CHOICE = "S3"
LEAST_STATIONS = 2
CARRYING = {"none": 0.0, "by hand": RELOCATION_BY_HAND_MINUTES, "by crane": RELOCATION_BY_CRANE_MINUTES}
"""Times in minutes of carrying the artefact to another station that are compared."""

_NAMED_FRONTS = ("none", "by crane")  # the names of a third front would overlap
_NAME_OFFSET = 5  # points between a marker and the corner of its name
_CROWDED_SHARE = 0.04  # of the longest machine time: the name of a set with a later set this near is at its lower left


@dataclass(frozen=True, eq=False)
class Strategy:
    """Combination of position sets of the artefact, with its planned measurement, its machine time, and one verdict
    (volumetric error after compensation) for each variant of the identification options.

    `set_minutes` is the machine time without carrying the artefact. `carries` is the number of times that the artefact
    is carried to a station, the first included unless it stands there, and `carry_minutes` is the time of each.
    `stations` is the number of stations.
    """

    name: str
    trial: ProcedureVariant
    set_minutes: float
    carries: int
    carry_minutes: float
    stations: int
    verdicts: tuple[Verdict, ...]

    @property
    def minutes(self) -> float:
        """Machine time with carrying, in minutes."""
        return self.minutes_with(self.carry_minutes)

    def minutes_with(self, carry_minutes: float) -> float:
        """Return the machine time in minutes if carrying the artefact to another station takes `carry_minutes`."""
        return self.set_minutes + self.carries * carry_minutes


def run(case: StudyCase) -> StudyResult:
    """Evaluate all combinations of the published position sets S1, S2 and S3 at the stations of the study case, and at
    some of these stations.

    Whole procedures are simulated with all stations. With fewer stations, only the first identification variant is
    evaluated, in closed form.
    """
    evaluator, variants = ProcedureEvaluator(case), identification_variants(case.options)
    found = _strategies(case, evaluator, variants, case.stations, simulated=True)
    fewer = [
        one
        for count in range(LEAST_STATIONS, len(case.stations))
        for one in _strategies(case, evaluator, variants[:1], spread(case.stations, count), simulated=False)
    ]
    fronts = [pareto_front(found, variant) for variant in range(len(variants))]
    return StudyResult(
        name=NAME,
        title="Combinations of position sets against machine time",
        columns=(
            "sets",
            "stations",
            "machine_minutes",
            "machine_minutes_without_carrying",
            *COLUMNS,
            "on_pareto_front",
        ),
        rows=[
            *(_row(one, variant, n, one.name in fronts[n]) for one in found for n, variant in enumerate(variants)),
            *(_row(one, variants[0], 0, None) for one in fewer),
        ],
        summary={
            **_summary(found, fewer, variants, fronts, evaluator.before),
            "vce_by_frame_um": {
                variant.label: {one.name: errors_by_frame(evaluator, one.trial, variant) for one in found}
                for variant in variants
            },
        },
        draw=partial(_draw, found=found, fewer=fewer, variants=variants, fronts=fronts, before=evaluator.before),
        size_in=(13.0, 10.4),
    )


def spread(stations: Sequence[int], count: int) -> tuple[int, ...]:
    """Return `count` of the `stations`, spread over them as evenly as possible, the first and the last included."""
    return tuple(stations[round(at)] for at in np.linspace(0, len(stations) - 1, count))


def errors_by_frame(
    evaluator: ProcedureEvaluator, trial: ProcedureVariant, variant: IdentificationVariant
) -> dict[str, float] | None:
    """Return the expected VCE in µm of one procedure by the way in which the six rigid terms are determined.

    `work_offset` sets the zero point alone, in the middle of the travel, as `work_frame` does together with the
    rotation. `known_places` fits the rigid motion to the measured balls, as if the places of the mount on the machine
    were known. The result is None if the procedure does not identify the machine.
    """
    budget = evaluator.budget(trial, variant)
    if budget is None or trial.planned is None:
        return None
    middle = [0.5 * (low + high) for low, high in evaluator.field.model.ranges_mm]
    forms = {
        "work_offset": WorkFrameForm.zeroed_at(evaluator.field, middle),
        "work_frame": evaluator.work_frame,
        "known_places": WorkFrameForm.fitted_at(evaluator.field, trial.planned.axis_positions),
    }
    by_form = {name: UM_PER_MM * form.expected_mm(budget) for name, form in forms.items()}
    return {AS_DEFINED.key: budget.expected.raw_um, **by_form, ALIGNED.key: budget.expected.aligned_um}


def _strategies(
    case: StudyCase,
    evaluator: ProcedureEvaluator,
    variants: Sequence[IdentificationVariant],
    stations: Sequence[int],
    *,
    simulated: bool,
) -> list[Strategy]:
    sets = [[p for p in case.positions(expression) if p.station in stations] for expression in SET_EXPRESSIONS]
    trials = [ProcedureVariant.of(case, case.artefact, positions) for positions in sets]
    times = [set_time(case.job, positions) for positions in sets]
    rows = evaluator.evaluate(trials, variants, range(len(trials)) if simulated else ())
    return [
        Strategy(name, trial, *time, case.relocation_minutes, len(stations), row)
        for name, trial, time, row in zip(SET_EXPRESSIONS, trials, times, rows, strict=True)
    ]


def set_time(job: Job, positions: Sequence[Position]) -> tuple[float, int]:
    """Return the machine minutes of `positions` without carrying, and how often the artefact is carried."""
    timing = job.settings.timing.model_copy(update={"relocation_minutes": 1.0})
    found = machine_minutes(replace(job, settings=job.settings.model_copy(update={"timing": timing})), positions)
    return found.total - found.carrying, round(found.carrying)


def pareto_front(
    found: Sequence[Strategy], variant: int, measure: ErrorMeasure = ALIGNED, carry_minutes: float | None = None
) -> tuple[str, ...]:
    """Return the names of the combinations of position sets on the Pareto front of machine time and volumetric error
    after compensation (VCE), in ascending order of machine time. A combination is on the front if every other
    combination is worse in machine time, in VCE or in both. The VCE is taken in `measure`. If `carry_minutes` is given,
    it replaces the time of carrying.
    """
    return tuple(one.name for one in _front(found, variant, measure, carry_minutes))


def _front(
    found: Sequence[Strategy], variant: int, measure: ErrorMeasure, carry_minutes: float | None
) -> list[Strategy]:
    known = [
        (one.minutes if carry_minutes is None else one.minutes_with(carry_minutes), value, one.name, one)
        for one in found
        if (value := measure.um(one.verdicts[variant])) is not None
    ]
    best, front = float("inf"), []
    for _, value, _, one in sorted(known, key=lambda entry: entry[:3]):
        if value < best:
            best = value
            front.append(one)
    return front


def _row(one: Strategy, variant: IdentificationVariant, number: int, on_front: bool | None) -> tuple[Cell, ...]:
    verdict = cells(variant.label, one.trial, one.verdicts[number])
    return (one.name, one.stations, one.minutes, one.set_minutes, *verdict, on_front)


def _summary(
    found: Sequence[Strategy],
    fewer: Sequence[Strategy],
    variants: Sequence[IdentificationVariant],
    fronts: Sequence[tuple[str, ...]],
    before: Verdict,
) -> dict[str, object]:
    return {
        "set": "all combinations of " + ", ".join(POSITION_SETS),
        **values_before(before),
        "carry_minutes": found[0].carry_minutes,
        "machine_minutes": {one.name: one.minutes for one in found},
        "machine_minutes_without_carrying": {one.name: one.set_minutes for one in found},
        **{
            f"vce_{measure.key}_um": {
                variant.label: {one.name: measure.um(one.verdicts[number]) for one in found}
                for number, variant in enumerate(variants)
            }
            for measure in MEASURES
        },
        "pareto_front": {variant.label: list(names) for variant, names in zip(variants, fronts, strict=True)},
        "pareto_front_as_defined": {
            variant.label: list(pareto_front(found, number, AS_DEFINED)) for number, variant in enumerate(variants)
        },
        "pareto_front_over_stations": {
            what: [f"{one.name} at {one.stations}" for one in _front([*found, *fewer], 0, ALIGNED, minutes)]
            for what, minutes in CARRYING.items()
        },
        "published_choice": PUBLISHED_CHOICE,
        "not_identified": {
            variant.label: [one.name for one in found if one.verdicts[number].expected is None]
            for number, variant in enumerate(variants)
        },
        "machines_refused": refused_machines([one.verdicts for one in found]),
        "worst_deviation_in_standard_errors": worst_deviation([one.verdicts for one in found]),
    }


def _draw(
    figure: Figure,
    found: Sequence[Strategy],
    fewer: Sequence[Strategy],
    variants: Sequence[IdentificationVariant],
    fronts: Sequence[tuple[str, ...]],
    before: Verdict,
) -> None:
    slots = figure.add_gridspec(2, 2)
    for number, measure in enumerate(MEASURES):
        slot = slots[divmod(number, 2)]
        panel = BrokenAxes.add(figure, slot, [one.verdicts for one in found], before, measure)
        for variant in range(len(fronts)):
            _draw_variant(panel, found, variant, pareto_front(found, variant, measure))
        panel.draw_before(before)
        panel.set_abscissa(0.0, 1.12 * max(one.minutes for one in found))
        carried = f"machine time with {found[0].carry_minutes:g} min for each carrying / min"
        panel.label(f"Combinations of S1, S2, S3, {measure.title}; lines: Pareto fronts", carried)
    _draw_stations(figure.add_subplot(slots[1, 1]), [*found, *fewer], variants[0].label)
    draw_legend(figure, [variant.title for variant in variants], before)


def _draw_stations(axes: Axes, every: Sequence[Strategy], label: str) -> None:
    """Draw the Pareto fronts over sets and numbers of stations for each time of carrying."""
    for series, (what, minutes) in enumerate(CARRYING.items()):
        front = _front(every, 0, ALIGNED, minutes)
        times = [one.minutes_with(minutes) for one in front]
        values = [ALIGNED.um(one.verdicts[0]) or 0.0 for one in front]
        axes.plot(times, values, color=SERIES[series], marker=MARKERS[series], label=f"{what}, {minutes:g} min")
        if what in _NAMED_FRONTS:
            left = minutes == 0.0
            for one, time, value in zip(front, times, values, strict=True):
                axes.annotate(
                    f"{one.name} at {one.stations}",
                    (time, value),
                    (-_NAME_OFFSET, -_NAME_OFFSET) if left else (_NAME_OFFSET, _NAME_OFFSET),
                    textcoords="offset points",
                    ha="right" if left else "left",
                    va="top" if left else "baseline",
                    fontsize=6.5,
                    color=SERIES[series],
                )
    axes.set_title(f"Sets at {LEAST_STATIONS} and more stations, {label}", fontsize=9.5)
    axes.set_xlabel("machine time / min")
    from_zero(axes, f"VCE, {ALIGNED.title} / µm")
    axes.set_xlim(left=-12.0, right=1.15 * axes.get_xlim()[1])
    axes.legend(title="time of carrying to the next station", loc="upper right")


def _draw_variant(panel: BrokenAxes, found: Sequence[Strategy], variant: int, names: Sequence[str]) -> None:
    """Draw all combinations as small labelled markers, and those on the Pareto front as large markers connected by a
    line."""
    measure = panel.measure
    best = sorted((one for one in found if one.name in names), key=lambda one: one.minutes)
    others = [one for one in found if one.name not in names and measure.um(one.verdicts[variant]) is not None]
    panel.draw_curve([one.minutes for one in best], [one.verdicts[variant] for one in best], variant)
    for one in others:
        left_um = measure.um(one.verdicts[variant]) or 0.0
        panel.axes_for(left_um).plot(one.minutes, left_um, "x", color=SERIES[variant], markersize=5)
    panel.draw_simulated([one.minutes for one in others], [one.verdicts[variant] for one in others], SERIES[variant])
    near = _CROWDED_SHARE * max(one.minutes for one in found)
    for one in found:
        value = measure.um(one.verdicts[variant])
        if value is not None:
            crowded = any(0.0 < other.minutes - one.minutes < near for other in found)
            _name(panel.axes_for(value), one, value, bold=one.name in names, left=crowded)


def _name(axes: Axes, one: Strategy, value_um: float, *, bold: bool, left: bool) -> None:
    axes.annotate(
        one.name,
        (one.minutes, value_um),
        (-_NAME_OFFSET, -_NAME_OFFSET) if left else (_NAME_OFFSET, _NAME_OFFSET),
        textcoords="offset points",
        ha="right" if left else "left",
        va="top" if left else "baseline",
        fontsize=7.5,
        fontweight="bold" if bold else "normal",
        bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0.0, "pad": 0.6},
    )
