"""Study of the number of balls needed on a bar of given length. It computes the volumetric error after compensation
with 3 to 15 balls, and the reduction of the volumetric error with each number of balls as a share of the largest
reduction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import INK, MARKERS, QUIET, SERIES
from agent.planning.design.bar_variants import Bar
from agent.studies.identification_variants import IdentificationVariant, identification_variants
from agent.studies.measure import ALIGNED, AS_DEFINED, MEASURES, ErrorMeasure, share_of_gain, values_before
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import Cell, StudyCase, StudyResult
from agent.studies.verdict_figure import BrokenAxes, draw_legend
from agent.studies.verdict_table import COLUMNS, cells, refused_machines, worst_deviation

NAME = "ball-count"
COUNTS = tuple(range(3, 16))
CHECKED = (3, 7, 11, 15)
SUFFICIENT_SHARE = 0.95
PUBLISHED_BALLS = 7
AXIS_LABEL = "balls over the same length"


@dataclass(frozen=True, eq=False)
class Curve:
    """Results of one identification variant for each number of balls in `COUNTS` (3 to 15).

    `before` is the volumetric error (VE) without compensation, and `verdicts` contains the volumetric error after
    compensation (VCE) for each number of balls.
    """

    variant: IdentificationVariant
    before: Verdict
    verdicts: tuple[Verdict, ...]

    def shares(self, measure: ErrorMeasure) -> tuple[float | None, ...]:
        """Return the reduction of the volumetric error for each number of balls as a share of the largest reduction.

        A share is None if the machine is not identified with this number of balls, or if no number of balls reduces the
        volumetric error.
        """
        return share_of_gain([measure.um(verdict) for verdict in self.verdicts], measure.um(self.before) or 0.0)

    def fewest(self, measure: ErrorMeasure) -> int | None:
        """Return the smallest number of balls whose reduction of the volumetric error, as a share of the largest
        reduction, is at least `SUFFICIENT_SHARE`; None if no number reaches this share."""
        shares = zip(COUNTS, self.shares(measure), strict=True)
        return next((n for n, share in shares if share and share >= SUFFICIENT_SHARE), None)


def run(case: StudyCase) -> StudyResult:
    """Evaluate artefact bars with 3 to 15 balls, all as long as the bar of `case`, in the position set of `case`."""
    bar, evaluator, variants, positions = (
        Bar.of(case.artefact),
        ProcedureEvaluator(case),
        identification_variants(case.options),
        case.positions(),
    )
    trials = [ProcedureVariant.of(case, bar.with_(balls=count), positions) for count in COUNTS]
    rows = evaluator.evaluate(trials, variants, [COUNTS.index(count) for count in CHECKED])
    before = evaluator.before
    curves = [
        Curve(variant, before, verdicts) for variant, verdicts in zip(variants, zip(*rows, strict=True), strict=True)
    ]
    return StudyResult(
        name=NAME,
        title="Number of balls over a constant length",
        columns=("balls", *COLUMNS, "share_of_gain", "share_of_gain_as_defined"),
        rows=_rows(trials, curves),
        summary=_summary(curves, rows, before),
        draw=partial(_draw, curves=curves, before=before),
        size_in=(10.0, 8.4),
    )


def _rows(trials: Sequence[ProcedureVariant], curves: Sequence[Curve]) -> list[tuple[Cell, ...]]:
    return [
        (count, *cells(curve.variant.label, trial, verdict), *shares)
        for curve in curves
        for count, trial, verdict, *shares in zip(
            COUNTS, trials, curve.verdicts, curve.shares(ALIGNED), curve.shares(AS_DEFINED), strict=True
        )
    ]


def _summary(curves: Sequence[Curve], rows: Sequence[Sequence[Verdict]], before: Verdict) -> dict[str, object]:
    return {
        **values_before(before),
        "fewest_balls_with_95_percent": {curve.variant.label: curve.fewest(ALIGNED) for curve in curves},
        "fewest_balls_with_95_percent_as_defined": {curve.variant.label: curve.fewest(AS_DEFINED) for curve in curves},
        "published_fewest_balls": PUBLISHED_BALLS,
        **{
            f"vce_{measure.key}_um": {
                curve.variant.label: {str(n): measure.um(curve.verdicts[COUNTS.index(n)]) for n in CHECKED}
                for curve in curves
            }
            for measure in MEASURES
        },
        "not_identified": {
            curve.variant.label: [
                n for n, verdict in zip(COUNTS, curve.verdicts, strict=True) if verdict.expected is None
            ]
            for curve in curves
        },
        "machines_refused": refused_machines(rows),
        "worst_deviation_in_standard_errors": worst_deviation(rows),
    }


def _draw(figure: Figure, curves: Sequence[Curve], before: Verdict) -> None:
    slots = figure.add_gridspec(2, 2)
    for number, measure in enumerate(MEASURES):
        panel = BrokenAxes.add(figure, slots[divmod(number, 2)], [curve.verdicts for curve in curves], before, measure)
        for series, curve in enumerate(curves):
            panel.draw_curve(COUNTS, curve.verdicts, series)
        panel.draw_before(before)
        panel.label(f"Volumetric error left, {measure.title}", AXIS_LABEL)
        panel.set_abscissa(COUNTS[0] - 0.5, COUNTS[-1] + 0.5, COUNTS)
    _draw_shares(figure.add_subplot(slots[1, 1]), curves)
    draw_legend(figure, [curve.variant.title for curve in curves], before)


def _draw_shares(axes: Axes, curves: Sequence[Curve]) -> None:
    """Draw the shares of all variants that reduce the error, and mark the published number of balls."""
    axes.axhline(100.0 * SUFFICIENT_SHARE, color=QUIET, linestyle=":")
    axes.axvline(PUBLISHED_BALLS, color=INK, linestyle="--", linewidth=1.0)
    for series, curve in enumerate(curves):
        shares = [
            (n, 100.0 * share) for n, share in zip(COUNTS, curve.shares(ALIGNED), strict=True) if share is not None
        ]
        if shares:
            axes.plot(*zip(*shares, strict=True), color=SERIES[series], marker=MARKERS[series], markersize=3.5)
    axes.set_title(
        f"Share of the gain, rigidly aligned; published: {PUBLISHED_BALLS} balls give {100 * SUFFICIENT_SHARE:g} %"
    )
    axes.set_xlabel(AXIS_LABEL)
    axes.set_xticks(COUNTS)
    axes.set_ylabel("share of the largest gain / %")
