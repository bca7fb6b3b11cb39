"""Study of the effect of tilted ball holders. It computes the volumetric error after compensation for tilts of 0 to 30
degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from matplotlib.figure import Figure

from agent.planning.design.bar_variants import Bar
from agent.studies.identification_variants import IdentificationVariant, identification_variants
from agent.studies.measure import ALIGNED, MEASURES, ErrorMeasure, values_before
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import StudyCase, StudyResult
from agent.studies.verdict_figure import BrokenAxes, draw_legend
from agent.studies.verdict_table import COLUMNS, cells, refused_machines, worst_deviation

NAME = "misalignment"
TILTS_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
CHECKED_DEG = (0.0, 15.0, 30.0)
SETS = ("S2", "S2+S3")

Verdicts = Sequence[tuple[Verdict, ...]]


def run(case: StudyCase) -> StudyResult:
    """Evaluate the artefact bar of `case` with each tilt of its ball holders, in the position sets S2 and S2+S3."""
    bar, evaluator, variants = Bar.of(case.artefact), ProcedureEvaluator(case), identification_variants(case.options)
    cases = [(name, tilt) for name in SETS for tilt in TILTS_DEG]
    trials = [ProcedureVariant.of(case, bar.with_(tilt_deg=tilt), case.positions(name)) for name, tilt in cases]
    checked = [number for number, (_, tilt) in enumerate(cases) if tilt in CHECKED_DEG]
    rows = evaluator.evaluate(trials, variants, checked)
    by_set = {name: rows[n * len(TILTS_DEG) : (n + 1) * len(TILTS_DEG)] for n, name in enumerate(SETS)}
    return StudyResult(
        name=NAME,
        title="Tilt of the ball holders",
        columns=("set", "tilt_deg", *COLUMNS),
        rows=[
            (name, tilt, *cells(variant.label, trial, verdict))
            for (name, tilt), trial, row in zip(cases, trials, rows, strict=True)
            for variant, verdict in zip(variants, row, strict=True)
        ],
        summary=_summary(variants, by_set, evaluator.before),
        draw=partial(_draw, variants=variants, by_set=by_set, before=evaluator.before),
        size_in=(12.6, 8.4),
    )


def saving(rows: Verdicts, variant: int, measure: ErrorMeasure = ALIGNED) -> float | None:
    """Return the share by which the volumetric error after compensation (VCE) with the largest tilt of the ball holders
    is smaller than the VCE without tilt.

    The VCE is taken in `measure`. `variant` is the index of the identification variant. Return None if the machine is
    not identified with the largest tilt or without tilt.
    """
    straight, tilted = measure.um(rows[0][variant]), measure.um(rows[-1][variant])
    return None if straight is None or tilted is None else 1.0 - tilted / straight


def _summary(
    variants: Sequence[IdentificationVariant], by_set: Mapping[str, Verdicts], before: Verdict
) -> dict[str, object]:
    return {
        "set": " and ".join(SETS),
        **values_before(before),
        **{
            f"saved_by_largest_tilt{suffix}": {
                variant.label: {name: saving(rows, number, measure) for name, rows in by_set.items()}
                for number, variant in enumerate(variants)
            }
            for suffix, measure in zip(("_as_defined", "_in_work_frame", ""), MEASURES, strict=True)
        },
        **{
            f"vce_{measure.key}_um": {
                variant.label: {
                    name: {f"{tilt:g}": measure.um(rows[TILTS_DEG.index(tilt)][number]) for tilt in CHECKED_DEG}
                    for name, rows in by_set.items()
                }
                for number, variant in enumerate(variants)
            }
            for measure in MEASURES
        },
        "not_identified": {
            variant.label: [
                f"{name}, {tilt:g}°"
                for name, rows in by_set.items()
                for tilt, row in zip(TILTS_DEG, rows, strict=True)
                if row[number].expected is None
            ]
            for number, variant in enumerate(variants)
        },
        "machines_refused": refused_machines([row for rows in by_set.values() for row in rows]),
        "worst_deviation_in_standard_errors": worst_deviation([row for rows in by_set.values() for row in rows]),
    }


def _draw(
    figure: Figure, variants: Sequence[IdentificationVariant], by_set: Mapping[str, Verdicts], before: Verdict
) -> None:
    slots = figure.add_gridspec(len(by_set), len(MEASURES))
    every = [row for rows in by_set.values() for row in rows]
    for line, (name, rows) in enumerate(by_set.items()):
        for column, measure in enumerate(MEASURES):
            panel = BrokenAxes.add(figure, slots[line, column], every, before, measure)
            for series, _ in enumerate(variants):
                panel.draw_curve(TILTS_DEG, [row[series] for row in rows], series)
            panel.draw_before(before)
            panel.label(f"{name}, {measure.title}", "tilt of the holders θ / °")
            panel.set_abscissa(TILTS_DEG[0] - 1.5, TILTS_DEG[-1] + 1.5, TILTS_DEG)
    draw_legend(figure, [variant.title for variant in variants], before)
