"""Choice of position sets. The study evaluates the named sets S1, S2, S3 of artefact positions and all their
combinations. It compares the volumetric error after compensation (VCE) and the machine time of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import SERIES
from agent.planning.cycle_time import machine_minutes
from agent.studies.identification_variants import IdentificationVariant, identification_variants
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import StudyCase, StudyResult
from agent.studies.verdict_figure import BrokenAxes, draw_legend, draw_simulated
from agent.studies.verdict_table import COLUMNS, aligned_um, cells, worst_deviation
from twin.artefact.position_set import POSITION_SETS, SET_EXPRESSIONS
from twin.machine.volumetric import VolumetricRms

NAME = "strategy"
PUBLISHED_CHOICE = "S3"

_NAME_OFFSET = 5  # points between a marker and the corner of its name
_CROWDED_SHARE = 0.04  # of the longest machine time: the name of a set with a later set this near is at its lower left


@dataclass(frozen=True, eq=False)
class Strategy:
    """Combination of position sets of the artefact, with its planned measurement, its machine time, and one verdict
    (volumetric error after compensation) for each variant of the identification options.
    """

    name: str
    trial: ProcedureVariant
    minutes: float
    verdicts: tuple[Verdict, ...]


def run(case: StudyCase) -> StudyResult:
    """Evaluate all combinations of the published position sets S1, S2 and S3 at the stations of the study case."""
    evaluator, variants = ProcedureEvaluator(case), identification_variants(case.options)
    sets = [case.positions(expression) for expression in SET_EXPRESSIONS]
    trials = [ProcedureVariant.of(case, case.artefact, positions) for positions in sets]
    minutes = [machine_minutes(case.job, positions).total for positions in sets]
    rows = evaluator.evaluate(trials, variants, range(len(trials)))
    found = [Strategy(*parts) for parts in zip(SET_EXPRESSIONS, trials, minutes, rows, strict=True)]
    fronts = [pareto_front(found, variant) for variant in range(len(variants))]
    return StudyResult(
        name=NAME,
        title="Combinations of position sets against machine time",
        columns=("sets", "machine_minutes", *COLUMNS, "on_pareto_front"),
        rows=[
            (one.name, one.minutes, *cells(variant.label, one.trial, one.verdicts[number]), one.name in fronts[number])
            for one in found
            for number, variant in enumerate(variants)
        ],
        summary=_summary(found, variants, fronts, evaluator.before),
        draw=partial(_draw, found=found, variants=variants, fronts=fronts, before=evaluator.before),
        size_in=(8.0, 5.6),
    )


def pareto_front(found: Sequence[Strategy], variant: int) -> tuple[str, ...]:
    """Return the names of the combinations of position sets on the Pareto front of machine time and volumetric error
    after compensation (VCE), in ascending order of machine time. A combination is on the front if every other
    combination is worse in machine time, in VCE or in both. The VCE is computed after the best-fitting rigid motion is
    removed.
    """
    known = [(one.minutes, aligned_um(one.verdicts[variant]), one.name) for one in found]
    best, names = float("inf"), []
    for _, value, name in sorted((minutes, value, name) for minutes, value, name in known if value is not None):
        if value < best:
            best = value
            names.append(name)
    return tuple(names)


def _summary(
    found: Sequence[Strategy],
    variants: Sequence[IdentificationVariant],
    fronts: Sequence[tuple[str, ...]],
    before: VolumetricRms,
) -> dict[str, object]:
    return {
        "set": "all combinations of " + ", ".join(POSITION_SETS),
        "ve_raw_um": before.raw_um,
        "ve_aligned_um": before.aligned_um,
        "machine_minutes": {one.name: one.minutes for one in found},
        "vce_aligned_um": {
            variant.label: {one.name: aligned_um(one.verdicts[number]) for one in found}
            for number, variant in enumerate(variants)
        },
        "pareto_front": {variant.label: list(names) for variant, names in zip(variants, fronts, strict=True)},
        "published_choice": PUBLISHED_CHOICE,
        "not_identified": {
            variant.label: [one.name for one in found if one.verdicts[number].expected is None]
            for number, variant in enumerate(variants)
        },
        "worst_deviation_in_standard_errors": worst_deviation([one.verdicts for one in found]),
    }


def _draw(
    figure: Figure,
    found: Sequence[Strategy],
    variants: Sequence[IdentificationVariant],
    fronts: Sequence[tuple[str, ...]],
    before: VolumetricRms,
) -> None:
    panel = BrokenAxes.add(figure, figure.add_gridspec(1, 1)[0], [one.verdicts for one in found], before)
    for variant, names in enumerate(fronts):
        _draw_variant(panel, found, variant, names)
    panel.draw_before(before)
    panel.set_abscissa(0.0, 1.12 * max(one.minutes for one in found))
    panel.label("Combinations of S1, S2, S3; lines: Pareto fronts", "machine time / min")
    draw_legend(figure, [variant.title for variant in variants], before)


def _draw_variant(panel: BrokenAxes, found: Sequence[Strategy], variant: int, names: Sequence[str]) -> None:
    """Draw all combinations as small labelled markers, and those on the Pareto front as large markers connected by a
    line."""
    best = sorted((one for one in found if one.name in names), key=lambda one: one.minutes)
    others = [one for one in found if one.name not in names and aligned_um(one.verdicts[variant]) is not None]
    panel.draw_curve([one.minutes for one in best], [one.verdicts[variant] for one in best], variant)
    for axes in panel.parts:
        axes.plot(
            [one.minutes for one in others],
            [aligned_um(one.verdicts[variant]) or 0.0 for one in others],
            "x",
            color=SERIES[variant],
            markersize=5,
        )
        for one in others:
            draw_simulated(axes, [one.minutes], [one.verdicts[variant]], SERIES[variant])
    near = _CROWDED_SHARE * max(one.minutes for one in found)
    for one in found:
        value = aligned_um(one.verdicts[variant])
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
