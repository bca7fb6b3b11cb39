"""Figure of the design of an artefact with its mount: expected error against machine time and against purchase."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, INK, ORANGE, QUIET, from_zero
from agent.planning.design.artefact_design import ArtefactDesign
from agent.planning.design.pareto_figure import MINUTES_ADDED
from agent.planning.design.pareto_front import FrontPoint, grown_front

FIGURE_SIZE_IN = (10.5, 4.4)
_NUMBERS = 6  # of positions, written at a front
_PRESENT: dict[str, Any] = {"linestyle": "", "marker": "D", "color": GREEN, "markersize": 8}
_BEST: dict[str, Any] = {"linestyle": "", "marker": "s", "color": ORANGE, "markersize": 8}
_ROOM_ABOVE = 1.45  # of the panel against time, for its legend
_LARGEST_OVER_FRONT = 3.0  # variants with an error of more than this multiple of the least are above the panel


def draw_artefact_design(figure: Figure, found: ArtefactDesign, slot_minutes: float, budget_euro: float) -> None:
    """Draw on the empty `figure` the Pareto fronts of the best and the present equipment against machine minutes, and
    all screened variants against their purchase with their Pareto front."""
    left, right = figure.subplots(1, 2)
    _draw_minutes(left, found, slot_minutes)
    _draw_euro(right, found, budget_euro)


def _draw_minutes(axes: Axes, found: ArtefactDesign, slot_minutes: float) -> None:
    shown = [("best found", BLUE, _BEST, found.best)]
    if found.present.design is not None and found.present.variant != found.best.variant:
        shown.append(("present", GREEN, _PRESENT, found.present))
    for above, (label, colour, style, one) in enumerate(shown):
        front = grown_front(one.result.front)
        minutes, vce_um = [p.minutes for p in front], [p.vce_um for p in front]
        axes.plot(minutes, vce_um, "-o", color=colour, markersize=4, label=f"{label}, front")
        _number(axes, front, colour, above=bool(above))
        for point in (point for point in one.result.front if point.design):
            axes.plot(point.minutes, point.vce_um, **style, label=f"{label}, designed: {point.positions} positions")
    axes.axvline(slot_minutes, color=INK, linewidth=0.8, linestyle=":", label=f"slot of {slot_minutes:g} min")
    axes.set_xlabel(f"machine time of the whole run / min (fronts: {MINUTES_ADDED})")
    axes.set_title("Expected VCE against machine time (numbers: positions)")
    axes.set_xlim(left=0.0)
    from_zero(axes, "expected VCE, rigidly aligned / µm")
    axes.set_ylim(top=_ROOM_ABOVE * axes.get_ylim()[1])
    axes.legend(loc="upper right")


def _number(axes: Axes, front: Sequence[FrontPoint], colour: str, *, above: bool) -> None:
    """Write the number of positions at some points of a front, on the side where the other front is not."""
    offset = (3, 5) if above else (-4, -13)
    for point in front[:: max(1, len(front) // _NUMBERS)]:
        at = (point.minutes, point.vce_um)
        axes.annotate(f"{point.positions}", at, offset, textcoords="offset points", color=colour)


def _draw_euro(axes: Axes, found: ArtefactDesign, budget_euro: float) -> None:
    measurable = [one for one in found.screened if one.measurable]
    axes.plot(
        [one.purchase_euro for one in measurable],
        [one.vce_um for one in measurable],
        ".",
        color=QUIET,
        alpha=0.6,
        label=f"{len(measurable)} variants, screened",
    )
    front = found.euro_front
    axes.plot([p.purchase_euro for p in front], [p.vce_um for p in front], "-o", color=BLUE, label="their Pareto front")
    for label, style, one in (
        ("present, designed", _PRESENT, found.present),
        ("best found, designed", _BEST, found.best),
    ):
        if one.design is not None:
            axes.plot(one.purchase_euro, one.vce_um, **style, label=label)
    axes.axvline(budget_euro, color=INK, linewidth=0.8, linestyle=":", label=f"budget of {budget_euro:g} €")
    axes.set_xlabel("purchase / €")
    axes.set_title("Expected VCE in this slot against purchase")
    from_zero(axes, "expected VCE, rigidly aligned / µm")
    least = min(one.vce_um for one in measurable)
    axes.set_ylim(top=min(axes.get_ylim()[1], _LARGEST_OVER_FRONT * least))
    axes.legend(loc="lower left")
