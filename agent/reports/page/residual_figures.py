"""What is left at the balls: by position, by ball, and held against a normal distribution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import ndtri

from agent.figures.report_style import BLUE, GREEN, INK, ORANGE, Drawing
from twin.arrays import Array

Indices = NDArray[np.int64]

COMPONENTS = (("x", BLUE, "o"), ("y", ORANGE, "s"), ("z", GREEN, "^"))


@dataclass(frozen=True)
class BallResiduals:
    """(n,) position and ball counts from 0, (n, 3) residuals in µm and in standard deviations, (n,) kept."""

    position: Indices
    ball: Indices
    residual_um: Array
    standardised: Array
    kept: NDArray[np.bool_]
    station_starts: tuple[int, ...] = ()

    @property
    def rms_per_ball(self) -> tuple[Indices, Array]:
        """Balls that were kept at least once and their rms by component, (b,) and (b, 3), µm."""
        balls = np.unique(self.ball[self.kept])
        rows = [self.residual_um[self.kept & (self.ball == ball)] for ball in balls]
        return balls, np.array([np.sqrt(np.mean(row**2, axis=0)) for row in rows]).reshape(-1, 3)


def draw_by_position(residuals: BallResiduals) -> str:
    """SVG: every ball's residual against its position, balls of a position side by side, rejected ones ringed."""
    drawing = Drawing("residuals-by-position", 10.4, 2.9)
    with drawing as figure:
        panel = figure.subplots()
        place = residuals.position + _spread(residuals.ball)
        _components(panel, place, residuals)
        for start in residuals.station_starts:
            panel.axvline(start - 0.5, color=INK, linewidth=0.6, linestyle=(0, (2, 3)))
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.set_xlim(-0.6, float(residuals.position.max()) + 0.6)
        panel.set_xlabel("position, counted from 0 (its balls from left to right)")
        panel.set_ylabel("residual / µm")
        panel.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handletextpad=0.2)
        panel.grid(visible=False, axis="x")
    return drawing.svg()


def draw_distribution(residuals: BallResiduals) -> str:
    """SVG: rms per ball and a normal probability plot of the standardised residuals."""
    drawing = Drawing("residual-distribution", 10.4, 2.7)
    with drawing as figure:
        figure.subplots_adjust(wspace=0.13)
        left, right = figure.subplots(1, 2)
        _per_ball(left, residuals)
        _normal_plot(right, residuals)
    return drawing.svg()


def _spread(ball: Indices) -> Array:
    """Offsets within ±0.35 that lay the balls of a position side by side."""
    return 0.7 * (ball / max(1, int(ball.max())) - 0.5)


def _components(panel: Axes, place: Array, residuals: BallResiduals) -> None:
    kept = residuals.kept
    for column, (name, colour, marker) in enumerate(COMPONENTS):
        value = residuals.residual_um[:, column]
        panel.plot(place[kept], value[kept], marker, color=colour, markersize=2.4, markeredgewidth=0, label=name)
    limit = 1.4 * float(np.abs(residuals.residual_um[kept]).max(initial=0.1))
    panel.set_ylim(-1.08 * limit, 1.08 * limit)
    if not kept.all():
        _rejected(panel, place[~kept], residuals.residual_um[~kept], limit)


def _rejected(panel: Axes, place: Array, residual: Array, limit: float) -> None:
    """The largest component of each with its value; what lies beyond the scale stands at its edge."""
    largest = residual[np.arange(len(residual)), np.abs(residual).argmax(axis=1)]
    shown = np.clip(largest, -limit, limit)
    panel.plot(place, shown, "o", markersize=7, markerfacecolor="none", markeredgecolor=INK, label="rejected")
    for x, y, value in zip(place, shown, largest, strict=True):
        text = f"{value:.0f} µm"
        panel.annotate(text, (x, y), xytext=(6, 0), textcoords="offset points", va="center", fontsize=7)


def _per_ball(panel: Axes, residuals: BallResiduals) -> None:
    balls, rms = residuals.rms_per_ball
    for column, (name, colour, marker) in enumerate(COMPONENTS):
        panel.plot(balls, rms[:, column], marker + "-", color=colour, markersize=4, linewidth=0.7, label=name)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("ball")
    panel.set_ylabel("rms residual / µm")
    panel.set_title("Each ball over all positions", loc="left")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handletextpad=0.2)


def _normal_plot(panel: Axes, residuals: BallResiduals) -> None:
    ordered = np.sort(residuals.standardised[residuals.kept].ravel())
    expected = ndtri((np.arange(ordered.size) + 0.5) / ordered.size)
    reach = 1.05 * float(max(np.abs(ordered).max(), np.abs(expected).max()))
    panel.plot([-reach, reach], [-reach, reach], color=INK, linewidth=0.8, label="normal, as assumed")
    panel.plot(expected, ordered, "o", color=BLUE, markersize=2.4, markeredgewidth=0, label="measured")
    panel.set_xlabel("expected standard normal quantile")
    panel.set_ylabel("residual / σ")
    panel.set_title("Normal probability plot", loc="left")
    panel.legend(loc="upper left")
