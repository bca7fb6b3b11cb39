"""Style of study figures, which have a light background, one set of colours, and labels with units.

The colours of lines and points are those of Okabe and Ito, which can be distinguished with the common forms of colour
blindness. The colours of maps are those of viridis, whose lightness increases evenly. Each drawing is rendered both as
PNG and as SVG.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from agent.figures.report_style import MAP_COLOURS

INK = "#1b2430"
QUIET = "#5a6675"
GRID = "#dfe4e9"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
PURPLE = "#cc79a7"
SKY = "#56b4e9"
AMBER = "#e69f00"
SERIES = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY, INK)
"""Colours of series, in order of use."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""Markers of series, so that series can be distinguished without colour."""

DOTS_PER_INCH = 150

Draw = Callable[[Figure], None]

_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.image_inline": True,
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=SERIES),
    "lines.linewidth": 1.5,
    "lines.markersize": 4.5,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.use": True,
    "image.cmap": MAP_COLOURS,
}


@dataclass(frozen=True)
class Picture:
    """Figure that has been rendered both as PNG and as SVG."""

    png: bytes
    svg: str


def picture(name: str, draw: Draw, size_in: tuple[float, float]) -> Picture:
    """Return a figure in the style of the studies, rendered as PNG and as SVG. The function `draw` receives the empty
    figure and draws on it.

    `size_in` contains the width and the height in inches. The same input always gives the same bytes.
    """
    with mpl.rc_context(_SETTINGS):
        mpl.rcParams["svg.hashsalt"] = name
        figure = Figure(figsize=size_in, dpi=DOTS_PER_INCH)
        draw(figure)
        return Picture(_png(figure), _svg(figure))


def headed(draw: Draw, heading: str) -> Draw:
    """Return a function that draws what `draw` draws, with the line `heading` above it.

    A title that `draw` gives to the whole figure stays below this line.
    """

    def draw_headed(figure: Figure) -> None:
        draw(figure)
        figure.suptitle("\n".join(filter(None, (heading, figure.get_suptitle()))), fontsize=8.5, color=QUIET)

    return draw_headed


def from_zero(axes: Axes, label: str) -> None:
    """Set the label of the vertical axis of the plot `axes` to `label`, and start the scale of this axis at zero."""
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    unstamped = {"Date": None, "Creator": None, "Format": None, "Type": None}
    FigureCanvasSVG(figure).print_svg(buffer, metadata=unstamped)  # type: ignore[no-untyped-call]
    return buffer.getvalue()
