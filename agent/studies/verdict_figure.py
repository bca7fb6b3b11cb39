"""Curves of the volumetric error after compensation (VCE) for several variants of the identification options. The VCE
axis is in two parts if the VCE of a variant is far larger than the error without compensation.

The lower part is linear from zero and shows the results worth comparing. The upper part is logarithmic and shows the
variants that make a machine much worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from agent.figures.style import MARKERS, QUIET, SERIES
from agent.studies.measure import ALIGNED, MEASURES, ErrorMeasure
from agent.studies.procedure_value import Verdict

FAR_BEYOND = 1.5
"""Multiple of VE above which a value is drawn in the upper part."""

TWO_STANDARD_ERRORS = 2.0
HEADROOM = 1.12


@dataclass(frozen=True, eq=False)
class BrokenAxes:
    """Axes of a diagram of the volumetric error after compensation, in one or two parts. The part `lower` is linear
    from zero to `limit_um`. The part `upper` is logarithmic and shows larger values. `upper` is None if there are no
    larger values. `measure` is the measure of the volumetric error that is drawn.
    """

    lower: Axes
    upper: Axes | None
    limit_um: float
    measure: ErrorMeasure

    @classmethod
    def add(
        cls,
        figure: Figure,
        slot: SubplotSpec,
        rows: Sequence[Sequence[Verdict]],
        before: Verdict,
        measure: ErrorMeasure = ALIGNED,
    ) -> BrokenAxes:
        """Add the axes to the cell `slot` of the figure's grid.

        Their scales have room for the volumetric error without compensation (`before`) and for the volumetric errors
        after compensation that the verdicts in `rows` predict in closed form.
        """
        # The scale is that of all measures, so that panels can be compared.
        every = [value for one in MEASURES for row in rows for value in map(one.um, row) if value is not None]
        uncompensated_um = max(one.um(before) or 0.0 for one in MEASURES)
        beyond = [value for value in every if value > FAR_BEYOND * uncompensated_um]
        near = [value for value in every if value <= FAR_BEYOND * uncompensated_um]
        limit_um = HEADROOM * max([*near, uncompensated_um])
        if not beyond:
            lower, upper = figure.add_subplot(slot), None
        else:
            parts = slot.subgridspec(2, 1, height_ratios=(1.0, 2.4), hspace=0.06)
            lower, upper = figure.add_subplot(parts[1]), figure.add_subplot(parts[0])
            _break(lower, upper, (max(0.75 * min(beyond), limit_um), 2.0 * max(beyond)))
        lower.set_ylim(0.0, limit_um)
        return cls(lower, upper, limit_um, measure)

    @property
    def parts(self) -> tuple[Axes, ...]:
        return (self.lower,) if self.upper is None else (self.lower, self.upper)

    def axes_for(self, value_um: float) -> Axes:
        """Return the part of the axes in which the value `value_um`, in µm, has to be drawn."""
        return self.lower if self.upper is None or value_um <= self.limit_um else self.upper

    @property
    def top(self) -> Axes:
        """Uppermost part of the axes, which carries the title."""
        return self.lower if self.upper is None else self.upper

    def draw_curve(self, coordinates: Sequence[float], verdicts: Sequence[Verdict], series: int) -> None:
        """Draw the volumetric error after compensation (VCE) of `verdicts` over `coordinates`. The closed-form VCE is a
        line, and the simulated VCE is drawn as open squares. The line is interrupted where the machine is not
        identified.
        """
        expected = [np.nan if value is None else value for value in map(self.measure.um, verdicts)]
        for axes in self.parts:
            axes.plot(coordinates, expected, color=SERIES[series], marker=MARKERS[series])

        self.draw_simulated(coordinates, verdicts, SERIES[series])

    def draw_simulated(self, coordinates: Sequence[float], verdicts: Sequence[Verdict], colour: str) -> None:
        """Draw the simulated volumetric error after compensation as open squares with error bars of two standard
        errors."""
        for coordinate, verdict in zip(coordinates, verdicts, strict=True):
            value, error = self.measure.of(verdict.simulated), self.measure.of(verdict.standard_error)
            if value is not None and error is not None:
                self.axes_for(value).errorbar(
                    [coordinate],
                    [value],
                    [TWO_STANDARD_ERRORS * error],
                    color=colour,
                    fmt="s",
                    ms=8,
                    mfc="none",
                    capsize=3,
                    elinewidth=1.0,
                )

    def draw_before(self, before: Verdict) -> None:
        self.lower.axhline(self.measure.um(before) or 0.0, color=QUIET, linestyle="--")

    def label(self, title: str, across: str) -> None:
        self.top.set_title(title)
        self.lower.set_xlabel(across)
        self.lower.set_ylabel(f"VCE, {self.measure.title} / µm")

    def set_abscissa(self, low: float, high: float, ticks: Sequence[float] | None = None) -> None:
        """Set the same abscissa limits and ticks for both parts of the axes."""
        for axes in self.parts:
            axes.set_xlim(low, high)
            if ticks is not None:
                axes.set_xticks(ticks)


def draw_legend(figure: Figure, titles: Sequence[str], before: Verdict) -> None:
    """Draw a legend below the diagrams. It explains the curves of the identification variants `titles` in this order,
    the line of the volumetric error without compensation (`before`), and the open squares of the simulated values.
    """
    levels = " / ".join(f"{measure.um(before) or 0.0:.1f}" for measure in MEASURES)
    entries = [
        Line2D([], [], color=SERIES[series], marker=MARKERS[series], label=title) for series, title in enumerate(titles)
    ]
    entries.append(Line2D([], [], color=QUIET, linestyle="--", label=f"not compensated, {levels} µm"))
    squares = "whole procedures simulated, ± 2 standard errors"
    entries.append(Line2D([], [], color=QUIET, linestyle="", marker="s", markersize=8, mfc="none", label=squares))
    figure.legend(handles=entries, loc="outside lower center", ncols=2)


def plain_numbers(axes: Axes) -> None:
    """Label a logarithmic ordinate with plain numbers such as 10, 30, 100 instead of powers of ten."""
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _break(lower: Axes, upper: Axes, limits_um: tuple[float, float]) -> None:
    upper.set_yscale("log")
    upper.set_ylim(*limits_um)
    plain_numbers(upper)
    upper.spines["bottom"].set_visible(False)
    upper.tick_params(axis="x", length=0, labelbottom=False)
    slash = {"marker": [(-1, -0.5), (1, 0.5)], "markersize": 8, "linestyle": "none", "color": "k", "clip_on": False}
    upper.plot([0], [0], transform=upper.transAxes, **slash)  # type: ignore[arg-type]
    lower.plot([0], [1], transform=lower.transAxes, **slash)  # type: ignore[arg-type]
