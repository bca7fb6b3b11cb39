"""Figures of the geometric error functions and of the cross-effect.

The figure of the geometric error functions has a row for each axis and a column for each of the six error motions of an
axis according to ISO 230-1.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BAND_OPACITY, BLUE, INK, ORANGE, REPORT_WIDTH_IN, Drawing
from agent.reports.page.error_curves import ErrorCurve
from twin.machine.kinematic_chain import AXES

COLUMNS = ("EX", "EY", "EZ", "EA", "EB", "EC")
CROSS_PANELS = 3
DISPLACEMENTS = 3
"""Number of columns with displacements; the other columns are rotations."""


def draw_error_curves(curves: Sequence[ErrorCurve]) -> str:
    """Return an SVG of the 18 geometric error functions (six for each of X, Y and Z). An error that is not in the error
    model gets an empty panel."""
    by_name = {curve.name: curve for curve in curves}
    drawing = Drawing("error-curves", REPORT_WIDTH_IN, 5.2)
    with drawing as figure:
        figure.subplots_adjust(wspace=0.16, hspace=0.5)
        panels = _panels(figure)
        for axis, row in zip(AXES, panels, strict=True):
            for kind, panel in zip(COLUMNS, row, strict=True):
                _panel(panel, by_name.get(kind + axis), kind + axis)
        for row in panels:
            _share_scale(row[:DISPLACEMENTS], _reach(curves, "µm"))
            _share_scale(row[DISPLACEMENTS:], _reach(curves, "µrad"))
        _label(panels)
    return drawing.svg()


def draw_cross_effect(curves: Sequence[ErrorCurve]) -> str:
    """Return an SVG of the cross-effect, that is, the bending of beams by the weight that the axes move. The
    contribution to each error motion is drawn as a function of its axis, with at most `CROSS_PANELS` in a row."""
    rows = -(-len(curves) // CROSS_PANELS)
    drawing = Drawing("cross-effect", REPORT_WIDTH_IN, 1.9 * rows)
    with drawing as figure:
        figure.subplots_adjust(wspace=0.35, hspace=0.6)
        layout = figure.add_gridspec(rows, min(len(curves), CROSS_PANELS))
        for number, curve in enumerate(curves):
            panel = figure.add_subplot(layout[divmod(number, CROSS_PANELS)])
            _panel(panel, curve, curve.name)
            panel.set_ylabel(curve.unit)
            panel.set_xlabel(f"{curve.argument} / mm")
    return drawing.svg()


def _panels(figure: Figure) -> list[list[Axes]]:
    """Return (3, 6) panels with a gap between displacements and rotations, which have different scales."""
    layout = figure.add_gridspec(3, 7, width_ratios=[1.0, 1.0, 1.0, 0.28, 1.0, 1.0, 1.0])
    columns = (0, 1, 2, 4, 5, 6)
    return [[figure.add_subplot(layout[row, column]) for column in columns] for row in range(3)]


def _panel(panel: Axes, curve: ErrorCurve | None, title: str) -> None:
    panel.set_title(title, loc="left", pad=3)
    panel.axhline(0.0, color=INK, linewidth=0.6)
    if curve is None:
        panel.text(0.5, 0.6, "not in the model", transform=panel.transAxes, ha="center", fontsize=7)
        return
    colour = BLUE if curve.unit == "µm" else ORANGE
    low, high = curve.value - curve.expanded_uncertainty, curve.value + curve.expanded_uncertainty
    panel.fill_between(curve.position_mm, low, high, color=colour, alpha=BAND_OPACITY, linewidth=0)
    (line,) = panel.plot(curve.position_mm, curve.value, color=colour)
    line.set_gid(f"curve-{curve.name}")
    low_mm, high_mm = float(curve.position_mm[0]), float(curve.position_mm[-1])
    panel.set_xlim(low_mm, high_mm)
    panel.set_xticks([low_mm, 0.5 * (low_mm + high_mm), high_mm])
    first, _, last = panel.get_xticklabels()  # inwards, so that numbers of neighbouring panels do not meet
    first.set_horizontalalignment("left")
    last.set_horizontalalignment("right")


def _reach(curves: Sequence[ErrorCurve], unit: str) -> float:
    return max((curve.reach for curve in curves if curve.unit == unit), default=0.0) or 1.0


def _share_scale(panels: Sequence[Axes], reach: float) -> None:
    """Set the same scale for panels side by side, with tick labels only at the first."""
    for count, panel in enumerate(panels):
        panel.set_ylim(-1.05 * reach, 1.05 * reach)
        panel.locator_params(axis="y", nbins=5)
        if count:
            panel.tick_params(axis="y", labelleft=False, length=0)


def _label(panels: Sequence[Sequence[Axes]]) -> None:
    for axis, row in zip(AXES, panels, strict=True):
        row[0].set_ylabel("µm", labelpad=0)
        row[DISPLACEMENTS].set_ylabel("µrad", labelpad=0)
        for panel in row:
            panel.set_xlabel(f"{axis} / mm", labelpad=1)
