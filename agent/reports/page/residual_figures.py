"""Figures of the residuals at the balls: by position, by ball, and compared with a normal distribution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.special import ndtri

from agent.figures.style import BLUE, GREEN, INK, ORANGE, REPORT_WIDTH_IN, Drawing
from twin.arrays import Array

Indices = NDArray[np.int64]

COMPONENTS = (("x", BLUE, "o"), ("y", ORANGE, "s"), ("z", GREEN, "^"))


@dataclass(frozen=True)
class BallResiduals:
    """Residuals of n measured balls.

    `position` (n,) and `ball` (n,) are indices counted from 0. `residual_um` (n, 3) holds the residuals in µm, and
    `standardised` (n, 3) holds the residuals divided by their standard deviations. `accepted` (n,) is False for balls
    that the identification rejected as outliers. `station_starts` contains the index of the first position of every
    station after the first station.
    """

    position: Indices
    ball: Indices
    residual_um: Array
    standardised: Array
    accepted: NDArray[np.bool_]
    station_starts: tuple[int, ...] = ()

    @property
    def rms_per_ball(self) -> tuple[Indices, Array]:
        """Indices (b,) of the b balls that were accepted at least once, and the rms (b, 3) of the three components of
        their residuals in µm."""
        balls = np.unique(self.ball[self.accepted])
        rows = [self.residual_um[self.accepted & (self.ball == ball)] for ball in balls]
        return balls, np.array([np.sqrt(np.mean(row**2, axis=0)) for row in rows]).reshape(-1, 3)


def draw_by_position(residuals: BallResiduals) -> str:
    """Return an SVG of the residuals over the positions. The balls of a position are drawn side by side, and balls
    rejected as outliers are circled."""
    drawing = Drawing("residuals-by-position", REPORT_WIDTH_IN, 2.9)
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
        panel.legend(
            ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handletextpad=0.2, markerscale=2.0
        )
        panel.grid(visible=False, axis="x")
    return drawing.svg()


def draw_distribution(residuals: BallResiduals) -> str:
    """Return an SVG with two panels: the rms residual of each ball, and a normal probability plot of the standardised
    residuals."""
    drawing = Drawing("residual-distribution", REPORT_WIDTH_IN, 2.7)
    with drawing as figure:
        figure.subplots_adjust(wspace=0.13)
        left, right = figure.subplots(1, 2)
        _per_ball(left, residuals)
        _normal_plot(right, residuals)
    return drawing.svg()


def _spread(ball: Indices) -> Array:
    """Return offsets within ±0.35 that place the balls of a position side by side."""
    return 0.7 * (ball / max(1, int(ball.max())) - 0.5)


def _components(panel: Axes, place: Array, residuals: BallResiduals) -> None:
    accepted = residuals.accepted
    for column, (name, colour, marker) in enumerate(COMPONENTS):
        value = residuals.residual_um[:, column]
        panel.plot(
            place[accepted], value[accepted], marker, color=colour, markersize=2.4, markeredgewidth=0, label=name
        )
    limit = 1.4 * float(np.abs(residuals.residual_um[accepted]).max(initial=0.1))
    panel.set_ylim(-1.08 * limit, 1.08 * limit)
    if not accepted.all():
        _rejected(panel, place[~accepted], residuals.residual_um[~accepted], limit)


def _rejected(panel: Axes, place: Array, residual: Array, limit: float) -> None:
    """Draw the largest component of each rejected ball with its value; values beyond the scale are drawn at its
    edge."""
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
    panel.set_title("rms per ball", loc="left")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    panel.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, handletextpad=0.2)


def _normal_plot(panel: Axes, residuals: BallResiduals) -> None:
    ordered = np.sort(residuals.standardised[residuals.accepted].ravel())
    expected = ndtri((np.arange(ordered.size) + 0.5) / ordered.size)
    reach = 1.05 * float(max(np.abs(ordered).max(), np.abs(expected).max()))
    panel.plot([-reach, reach], [-reach, reach], color=INK, linewidth=0.8, label="normal, as assumed")
    panel.plot(expected, ordered, "o", color=BLUE, markersize=2.4, markeredgewidth=0, label="measured")
    panel.set_xlabel("expected standard normal quantile")
    panel.set_ylabel("standardised residual")
    panel.set_title("Normal probability plot", loc="left")
    panel.legend(loc="upper left")
