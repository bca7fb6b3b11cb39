"""Style of report figures, with one set of colours. Text and axes follow the light or dark theme of the report page.

Figures are drawn with placeholder colours, which are replaced by CSS variables of the page in the finished SVG. The
same drawing can therefore be shown on a light screen, on a dark screen and on paper.

The colours of lines and points are those of Okabe and Ito, which can be distinguished with the common forms of colour
blindness. The colours of maps are those of viridis, whose lightness increases evenly.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK = "#010101"
"""Placeholder colour of text, axes and zero lines, replaced by `currentColor` of the page."""
GRID = "#020202"
BLUE = "#030303"
ORANGE = "#040404"
GREEN = "#050505"
PURPLE = "#060606"

MAP_COLOURS = "viridis"
BAND_OPACITY = 0.22

PAGE_VARIABLES = {
    INK: "currentColor",
    GRID: "var(--grid)",
    BLUE: "var(--blue)",
    ORANGE: "var(--orange)",
    GREEN: "var(--green)",
    PURPLE: "var(--purple)",
}

_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.image_inline": True,
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "savefig.dpi": 110,
}


@dataclass(frozen=True)
class Margins:
    """Margins around the panels of a report figure, in inches.

    The margins are fixed, because computing them from each drawing would double the time that a report takes.
    """

    left: float = 0.66
    right: float = 0.15
    bottom: float = 0.42
    top: float = 0.26


class Drawing:
    """Figure in the style of the reports, rendered as SVG. `width_in` and `height_in` are in inches.

    The object is a context manager that yields an empty matplotlib figure, in which the caller draws. After the `with`
    block, the method `svg` returns the result.
    """

    def __init__(self, name: str, width_in: float, height_in: float, margins: Margins | None = None) -> None:
        self.name = name
        self._size = (width_in, height_in)
        self._margins = margins or Margins()
        self._context = mpl.rc_context(_SETTINGS)
        self._svg = ""

    def __enter__(self) -> Figure:
        self._context.__enter__()
        mpl.rcParams["svg.hashsalt"] = self.name
        self._figure = Figure(figsize=self._size)
        self._figure.patch.set_alpha(0.0)
        room, (width, height) = self._margins, self._size
        self._figure.subplots_adjust(
            left=room.left / width,
            right=1.0 - room.right / width,
            bottom=room.bottom / height,
            top=1.0 - room.top / height,
        )
        return self._figure

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        try:
            if kind is None:
                self._svg = _themed(_raw_svg(self._figure), self.name)
        finally:
            self._context.__exit__(None, None, None)

    def svg(self) -> str:
        """Return the text of the `<svg>` element of the figure, for use in a page. The text is empty until the `with`
        block, in which the caller draws, has ended.
        """
        return self._svg


def make_transparent(axes: Axes) -> None:
    axes.patch.set_alpha(0.0)


def _raw_svg(figure: Figure) -> str:
    buffer = io.StringIO()
    for axes in figure.axes:
        make_transparent(axes)
    unstamped = {"Date": None, "Creator": None, "Format": None, "Type": None}
    FigureCanvasSVG(figure).print_svg(buffer, metadata=unstamped)  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _themed(svg: str, name: str) -> str:
    """Remove file-level metadata, use the page's colours and fonts, and prefix ids to keep them unique on the page."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<svg [^>]*?(viewBox="[^"]*")[^>]*>', rf'<svg {_NAMESPACES} \1 data-figure="{name}">', svg, count=1)
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    for stand_in, variable in PAGE_VARIABLES.items():
        svg = svg.replace(stand_in, variable)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: var(--figure-font)", svg)
    return re.sub(r"font: ([^;\"]*?)px [^;\"]*", r"font: \1px var(--figure-font)", svg)


_NAMESPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
