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
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant, Verdict
from agent.studies.study import Cell, StudyCase, StudyResult
from agent.studies.verdict_figure import BrokenAxes, draw_legend
from agent.studies.verdict_table import COLUMNS, aligned_um, cells, worst_deviation
from twin.machine.volumetric import VolumetricRms

NAME = "ball-count"
COUNTS = tuple(range(3, 16))
CHECKED = (3, 7, 11, 15)
SUFFICIENT_SHARE = 0.95
PUBLISHED_BALLS = 7
AXIS_LABEL = "balls over the same length"


@dataclass(frozen=True, eq=False)
class Curve:
    """Results of one identification variant for each number of balls in `COUNTS` (3 to 15).

    `verdicts` contains the volumetric error after compensation (VCE) for each number of balls. `shares` contains the
    reduction of the volumetric error as a share of the largest reduction. A share is None if the machine is not
    identified with this number of balls, or if no number of balls reduces the volumetric error.
    """

    variant: IdentificationVariant
    verdicts: tuple[Verdict, ...]
    shares: tuple[float | None, ...]

    @property
    def fewest(self) -> int | None:
        """Smallest number of balls whose reduction of the volumetric error, as a share of the largest reduction, is at
        least `SUFFICIENT_SHARE`; None if no number reaches this share."""
        return next(
            (n for n, share in zip(COUNTS, self.shares, strict=True) if share and share >= SUFFICIENT_SHARE), None
        )


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
        Curve(variant, verdicts, gain_shares(verdicts, before))
        for variant, verdicts in zip(variants, zip(*rows, strict=True), strict=True)
    ]
    return StudyResult(
        name=NAME,
        title="Number of balls over a constant length",
        columns=("balls", *COLUMNS, "share_of_gain"),
        rows=_rows(trials, curves),
        summary=_summary(curves, rows, before),
        draw=partial(_draw, curves=curves, before=before),
        size_in=(10.0, 4.4),
    )


def gain_shares(verdicts: Sequence[Verdict], before: VolumetricRms) -> tuple[float | None, ...]:
    """Return the gain for each number of balls as a share of the largest gain.

    The gain is the volumetric error (VE) without compensation (`before`) minus the volumetric error after compensation
    (VCE, in `verdicts`), both after the best-fitting rigid motion is removed. A share is None if the machine is not
    identified with this number of balls, or if no number of balls reduces the error.
    """
    left = [aligned_um(verdict) for verdict in verdicts]
    best = min((value for value in left if value is not None), default=before.aligned_um)
    if best >= before.aligned_um:
        return (None,) * len(verdicts)
    gain = before.aligned_um - best
    return tuple(None if value is None else (before.aligned_um - value) / gain for value in left)


def _rows(trials: Sequence[ProcedureVariant], curves: Sequence[Curve]) -> list[tuple[Cell, ...]]:
    return [
        (count, *cells(curve.variant.label, trial, verdict), share)
        for curve in curves
        for count, trial, verdict, share in zip(COUNTS, trials, curve.verdicts, curve.shares, strict=True)
    ]


def _summary(curves: Sequence[Curve], rows: Sequence[Sequence[Verdict]], before: VolumetricRms) -> dict[str, object]:
    return {
        "ve_raw_um": before.raw_um,
        "ve_aligned_um": before.aligned_um,
        "fewest_balls_with_95_percent": {curve.variant.label: curve.fewest for curve in curves},
        "published_fewest_balls": PUBLISHED_BALLS,
        "vce_aligned_um": {
            curve.variant.label: {str(n): aligned_um(curve.verdicts[COUNTS.index(n)]) for n in CHECKED}
            for curve in curves
        },
        "not_identified": {
            curve.variant.label: [
                n for n, verdict in zip(COUNTS, curve.verdicts, strict=True) if verdict.expected is None
            ]
            for curve in curves
        },
        "worst_deviation_in_standard_errors": worst_deviation(rows),
    }


def _draw(figure: Figure, curves: Sequence[Curve], before: VolumetricRms) -> None:
    slots = figure.add_gridspec(1, 2)
    panel = BrokenAxes.add(figure, slots[0], [curve.verdicts for curve in curves], before)
    for series, curve in enumerate(curves):
        panel.draw_curve(COUNTS, curve.verdicts, series)
    panel.draw_before(before)
    panel.label("Volumetric error left", AXIS_LABEL)
    panel.set_abscissa(COUNTS[0] - 0.5, COUNTS[-1] + 0.5, COUNTS)
    _draw_shares(figure.add_subplot(slots[1]), curves)
    draw_legend(figure, [curve.variant.title for curve in curves], before)


def _draw_shares(axes: Axes, curves: Sequence[Curve]) -> None:
    """Draw the shares of all variants that reduce the error, and mark the published number of balls."""
    axes.axhline(100.0 * SUFFICIENT_SHARE, color=QUIET, linestyle=":")
    axes.axvline(PUBLISHED_BALLS, color=INK, linestyle="--", linewidth=1.0)
    for series, curve in enumerate(curves):
        shares = [(n, 100.0 * share) for n, share in zip(COUNTS, curve.shares, strict=True) if share is not None]
        if shares:
            axes.plot(*zip(*shares, strict=True), color=SERIES[series], marker=MARKERS[series], markersize=3.5)
    axes.set_title(f"Share of the gain; published: {PUBLISHED_BALLS} balls give {100 * SUFFICIENT_SHARE:g} %")
    axes.set_xlabel(AXIS_LABEL)
    axes.set_xticks(COUNTS)
    axes.set_ylabel("share of the largest gain / %")
