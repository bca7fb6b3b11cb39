"""Style of all figures: one set of colours, fonts and axes for reports and studies.

The colours of lines and points are those of Okabe and Ito, which can be distinguished with the common forms of colour
blindness. The colours of maps are those of viridis, whose lightness increases evenly.

Figures of studies have a light background and are rendered both as PNG and as SVG. Figures of a report are rendered as
SVG, in which each colour is replaced by a CSS variable of the report page. The same drawing can therefore be shown on a
light screen, on a dark screen and on paper.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from agent.figures import FIGURE_ENDINGS
from drivers.errors import InputError

INK = "#1b2430"
"""Colour of text, axes and zero lines."""
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
MAP_COLOURS = "viridis"
BAND_OPACITY = 0.22
DOTS_PER_INCH = 150
REPORT_WIDTH_IN = 8.6
"""Width of a figure of a report. On A4 paper it is reduced by a sixth, so that its text stays readable."""

PAGE_VARIABLES = {
    INK: "currentColor",
    GRID: "var(--grid)",
    BLUE: "var(--blue)",
    ORANGE: "var(--orange)",
    GREEN: "var(--green)",
    PURPLE: "var(--purple)",
}
"""Colours that a figure of a report may use, with the CSS variables of the page that replace them."""

Draw = Callable[[Figure], None]

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
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}
_REPORT_SETTINGS: dict[Any, Any] = {
    **_SETTINGS,
    "axes.linewidth": 0.6,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.3,
    "savefig.dpi": 110,
    "axes.titley": 1.0,  # where titles stand anyway; to find that out for itself takes a tenth of the time of a report
}
_STUDY_SETTINGS: dict[Any, Any] = {
    **_SETTINGS,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "grid.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=SERIES),
    "lines.linewidth": 1.5,
    "lines.markersize": 4.5,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.use": True,
    "image.cmap": MAP_COLOURS,
}
_NAMESPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'


_NUMBER = r"-?\d+(?:\.\d*)?(?:e-?\d+)?"
_PAIR = re.compile(rf"({_NUMBER}) ({_NUMBER})")
_SHAPE = re.compile(r'<defs>\s*<path id="(?P<id>[^"]+)" d="(?P<d>[^"]*)"(?: style="(?P<style>[^"]*)")?/>\s*</defs>\s*')
"""Shape of a marker, as matplotlib defines it where it is used first."""
_USE = re.compile(r'<use xlink:href="#[^"]+" x="(?P<x>[^"]+)" y="(?P<y>[^"]+)"[^>]*/>')
_RUN = re.compile(
    r'<use xlink:href="#(?P<id>[^"]+)" x="[^"]+" y="[^"]+" style="(?P<style>[^"]*)"/>\s*'
    r'(?:<use xlink:href="#(?P=id)" x="[^"]+" y="[^"]+" style="(?P=style)"/>\s*)*'
)
"""Markers of one series, one after the other."""
_CIRCLE = re.compile(rf"\s*M 0 (?P<radius>{_NUMBER})(?:\s+C(?:\s+{_NUMBER}){{6}}){{8}}\s+z\s*")
"""Shape of a circle around the origin, as matplotlib draws it: from its lowest point, in eight curves."""


@dataclass(frozen=True)
class Picture:
    """Figure that has been rendered both as PNG and as SVG. `draw_pdf` renders it as PDF, which few people ask for."""

    png: bytes
    svg: str
    draw_pdf: Callable[[], bytes] = field(repr=False, compare=False)

    def in_format_of(self, file: Path) -> bytes | str:
        """Return the figure in the format that the ending of the name `file`, one of `FIGURE_ENDINGS`, says. Raises
        InputError for another ending."""
        match file.suffix.lower():
            case ".png":
                return self.png
            case ".svg":
                return self.svg
            case ".pdf":
                return self.draw_pdf()
        raise InputError(f"the name of a figure must end with one of {', '.join(FIGURE_ENDINGS)}", file=str(file))


def picture(name: str, draw: Draw, size_in: tuple[float, float]) -> Picture:
    """Return a figure in the style of the studies, rendered as PNG and as SVG. The function `draw` receives the empty
    figure and draws on it.

    `size_in` contains the width and the height in inches. The same input always gives the same bytes, also as PDF.
    """
    with mpl.rc_context(_STUDY_SETTINGS):
        mpl.rcParams["svg.hashsalt"] = name
        figure = Figure(figsize=size_in, dpi=DOTS_PER_INCH)
        draw(figure)
        return Picture(_png(figure), _svg(figure), lambda: _pdf(figure))


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
        self._context = mpl.rc_context(_REPORT_SETTINGS)
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
                for axes in self._figure.axes:
                    make_transparent(axes)
                self._svg = _themed(_svg(self._figure), self.name)
        finally:
            self._context.__exit__(None, None, None)

    def svg(self) -> str:
        """Return the text of the `<svg>` element of the figure, for use in a page. The text is empty until the `with`
        block, in which the caller draws, has ended.
        """
        return self._svg


def make_transparent(axes: Axes) -> None:
    axes.patch.set_alpha(0.0)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    unstamped = {"Date": None, "Creator": None, "Format": None, "Type": None}
    FigureCanvasSVG(figure).print_svg(buffer, metadata=unstamped)  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _pdf(figure: Figure) -> bytes:
    from matplotlib.backends.backend_pdf import FigureCanvasPdf  # noqa: PLC0415  reads fonts, for PDF only

    buffer = io.BytesIO()
    unstamped = {"CreationDate": None, "Creator": None, "Producer": None}
    with mpl.rc_context(_STUDY_SETTINGS):
        FigureCanvasPdf(figure).print_pdf(buffer, metadata=unstamped)  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def join_markers(svg: str) -> str:
    """Return an SVG of matplotlib in which all markers of a series are one path, and each tick mark is a path. Discs
    of one colour become lines without length and with round ends.

    Matplotlib refers to the shape of a marker once for each point, and a circle consists of eight curves. A report has
    thousands of them: resolving the references would take most of the time of its PDF, and the curves most of its size.
    """
    shapes = {found["id"]: found for found in _SHAPE.finditer(svg)}

    def joined(run: re.Match[str]) -> str:
        shape = shapes[run["id"]]
        steps = [(float(use["x"]), float(use["y"])) for use in _USE.finditer(run[0])]
        # the shape has its line, and each reference the filling
        style = "; ".join(part for part in (run["style"], shape["style"]) if part)
        circle = _CIRCLE.fullmatch(shape["d"])
        dot = None if circle is None else _dot_style(style, float(circle["radius"]))
        if dot is not None:
            return f'<path d="{" ".join(f"M {x:.6g} {y:.6g} h 0" for x, y in steps)}" style="{dot}"/>\n'
        return f'<path d="{" ".join(_moved(shape["d"], *step) for step in steps)}" style="{style}"/>\n'

    return _SHAPE.sub("", _RUN.sub(joined, svg))


def _dot_style(style: str, radius: float) -> str | None:
    """Return the style of a line without length that looks like a circle in `style`, or None if line and filling of
    the circle are not alike."""
    given = dict(part.split(": ", 1) for part in style.split("; ") if part)
    colour, opacity = given.get("fill", "none"), given.get("fill-opacity", "1")
    line = given.get("stroke", "none")
    alike = line == "none" or (line == colour and given.get("stroke-opacity", "1") == opacity)
    if colour == "none" or not alike:
        return None
    width = 2.0 * radius + (0.0 if line == "none" else float(given.get("stroke-width", "1")))
    return f"fill: none; stroke: {colour}; stroke-opacity: {opacity}; stroke-width: {width:.6g}; stroke-linecap: round"


def _moved(path: str, x: float, y: float) -> str:
    """Return a path of absolute commands, each with pairs of coordinates, moved by x and y."""
    return _PAIR.sub(lambda pair: f"{float(pair[1]) + x:.6g} {float(pair[2]) + y:.6g}", " ".join(path.split()))


def _themed(svg: str, name: str) -> str:
    """Remove file-level metadata, use the page's colours and fonts, and prefix ids to keep them unique on the page."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = join_markers(re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL))
    svg = re.sub(r'<svg [^>]*?(viewBox="[^"]*")[^>]*>', rf'<svg {_NAMESPACES} \1 data-figure="{name}">', svg, count=1)
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    for colour, variable in PAGE_VARIABLES.items():
        svg = svg.replace(colour, variable)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: var(--figure-font)", svg)
    return re.sub(r"font: ([^;\"]*?)px [^;\"]*", r"font: \1px var(--figure-font)", svg)
