"""Predicted curves of acceptance tests, drawn as ISO 230 draws them, for comparison with a laser or a ballbar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BAND_OPACITY, BLUE, INK, ORANGE, QUIET, Picture, headed, picture
from agent.workpiece.instrument_comparison import InstrumentComparison, MeasuredFigure
from twin.units import UM_PER_MM
from twin.workpiece.acceptance import PredictedTest
from twin.workpiece.angles import ANGLES

_COLUMNS = 3
_WIDTH_IN, _ROW_IN, _LEGEND_IN = 10.0, 2.3, 0.7
_CIRCLE_ROOM = 3.0  # radius of the nominal circle, in the largest deviations
_LABELS = ("without table, with U (k = 2)", "with table, with U (k = 2)")
_MEASURED_LABELS = ("measured without table", "measured with table")
_MARKERS = ("o", "s")
_MARKERS_ON_CIRCLE = 24
_MARKER_STYLE: Mapping[str, Any] = {"color": INK, "markerfacecolor": "none", "markersize": 3.0, "markeredgewidth": 0.8}

Measured = Mapping[str, Sequence[MeasuredFigure]]
"""Measured figures of a test by its name: without table and, if it was measured, with it."""


def draw_comparison(compared: InstrumentComparison) -> Picture:
    """Return a figure of the predicted curves of all tests with the measured ones on them."""
    measured: dict[str, list[MeasuredFigure]] = {}
    for figure in compared.figures:
        measured.setdefault(figure.test.test.feature.name, []).append(figure.measured)
    found = compared.predicted
    return draw_tests(found.tests, f"{found.heading}\n{compared.text}", measured)


def draw_tests(predicted: Sequence[PredictedTest], heading: str, measured: Measured | None = None) -> Picture:
    """Return a figure with one panel for each test that has a curve, and with the measured curves on it."""
    shown = [one for one in predicted if len(one.curve_mm) > 1]
    rows = -(-len(shown) // _COLUMNS)

    def draw(figure: Figure) -> None:
        for place, one in enumerate(shown, start=1):
            circle = one.test.standard == "ISO 230-4"
            axes = figure.add_subplot(rows, _COLUMNS, place, projection="polar" if circle else None)
            (_draw_circle if circle else _draw_line)(
                axes, one, () if measured is None else measured[one.test.feature.name]
            )
            axes.set_title(f"{one.test.standard}: {one.test.feature.name}", fontsize=8.5)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))

    return picture("acceptance", headed(draw, heading), (_WIDTH_IN, rows * _ROW_IN + _LEGEND_IN))


def _curves(one: PredictedTest) -> list[tuple[np.ndarray, str, str]]:
    curves = [(UM_PER_MM * one.curve_mm, BLUE, _LABELS[0])]
    return curves if one.corrected_mm is None else [*curves, (UM_PER_MM * one.corrected_mm, ORANGE, _LABELS[1])]


def _draw_line(axes: Axes, one: PredictedTest, measured: Sequence[MeasuredFigure]) -> None:
    expanded = UM_PER_MM * one.expanded_mm
    for curve, colour, label in _curves(one):
        axes.plot(one.test.along, curve, color=colour, label=label)
        axes.fill_between(one.test.along, curve - expanded, curve + expanded, color=colour, alpha=BAND_OPACITY, lw=0.0)
    for each, marker, label in zip(measured, _MARKERS, _MEASURED_LABELS, strict=False):
        axes.plot(one.test.along[0] + each.along, each.curve_um, marker, label=label, **_MARKER_STYLE)
    axes.axhline(0.0, color=QUIET, linewidth=0.6)
    axes.set_xlabel("position / mm", fontsize=8.0)
    axes.set_ylabel("angle / µrad" if one.test.feature.name in ANGLES else "deviation / µm", fontsize=8.0)


def _draw_circle(axes: Axes, one: PredictedTest, measured: Sequence[MeasuredFigure]) -> None:
    """Draw deviations from the nominal circle, which is shown smaller so that they can be seen."""
    expanded = UM_PER_MM * one.expanded_mm
    predicted_um = max(float(np.abs(curve).max()) for curve, *_ in _curves(one)) + float(expanded.max())
    # a machine that contradicts its estimate must not leave the picture
    largest = max(predicted_um, *(float(np.abs(each.curve_um).max()) for each in measured), 0.0)
    radius = _CIRCLE_ROOM * largest
    angles = np.append(one.test.along, one.test.along[0] + 2.0 * np.pi)
    for curve, colour, label in _curves(one):
        closed, band = np.append(curve, curve[0]), np.append(expanded, expanded[0])
        axes.plot(angles, radius + closed, color=colour, label=label)
        axes.fill_between(
            angles, radius + closed - band, radius + closed + band, color=colour, alpha=BAND_OPACITY, lw=0.0
        )
    for each, marker, label in zip(measured, _MARKERS, _MEASURED_LABELS, strict=False):
        some = slice(None, None, max(1, len(each.along) // _MARKERS_ON_CIRCLE))
        axes.plot(each.along[some], radius + each.curve_um[some], marker, label=label, **_MARKER_STYLE)
    axes.plot(angles, np.full_like(angles, radius), color=QUIET, linewidth=0.6)
    axes.set_ylim(0.0, radius + 1.5 * largest)
    axes.set_yticks([radius - largest, radius + largest], ["", f"± {largest:.1f} µm"], fontsize=7.0)
    axes.set_xticks(np.radians([0.0, 90.0, 180.0, 270.0]), _directions(one))
    axes.tick_params(pad=0.0)


def _directions(one: PredictedTest) -> list[str]:
    plane = one.test.feature.name.split()[1]
    return [f"{sign}{axis}" for sign in "+−" for axis in plane]
