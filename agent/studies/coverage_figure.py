"""Figure of the coverage study: observed coverage by form of deflection, and observed against nominal coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BAND_OPACITY, GREEN, INK, MARKERS, QUIET, SERIES
from twin.arrays import Array
from twin.uncertainty.coverage import ObservedCoverage

LEVELS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99])
BAND = (93.0, 97.0)
_REGION_OFFSET = 0.13  # horizontal distance between the regions of one form
_LOWEST = 70.0


@dataclass(frozen=True, eq=False)
class Panel:
    """Results of the coverage study for one choice of the Legendre order. `groups` contains the names of the forms of
    deflection and the name ``all``.

    `shares` maps each kind of confidence region to its observed coverage in each of `groups`. `curves` maps each kind
    of region to its observed coverage at each of the nominal levels `LEVELS`.
    """

    title: str
    groups: tuple[str, ...]
    shares: Mapping[str, Sequence[ObservedCoverage]]
    curves: Mapping[str, Array]


def draw(figure: Figure, panels: Sequence[Panel]) -> None:
    """Draw one row of two diagrams per panel.

    The left diagram shows the observed coverage by form of deflection. The right diagram shows the observed coverage
    against the nominal coverage.
    """
    axes = figure.subplots(len(panels), 2, width_ratios=(2.1, 1.0), squeeze=False)
    for (left, right), panel in zip(axes, panels, strict=True):
        _by_form(left, panel)
        _reliability(right, panel)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))


def _by_form(axes: Axes, panel: Panel) -> None:
    axes.axhspan(*BAND, color=GREEN, alpha=BAND_OPACITY, linewidth=0.0)
    axes.axhline(95.0, color=QUIET, linewidth=0.8)
    middle = 0.5 * (len(panel.shares) - 1)
    for number, (region, shares) in enumerate(panel.shares.items()):
        coordinates = np.arange(len(shares)) + _REGION_OFFSET * (number - middle)
        axes.errorbar(
            coordinates,
            [100.0 * share.observed for share in shares],
            [100.0 * share.standard_error for share in shares],
            fmt=MARKERS[number],
            color=SERIES[number],
            elinewidth=0.9,
            label=region,
        )
    axes.axvline(len(panel.groups) - 1.5, color=INK, linewidth=0.7)
    axes.set_xticks(range(len(panel.groups)), panel.groups)
    observed = [100.0 * share.observed for shares in panel.shares.values() for share in shares]
    axes.set_ylim(_LOWEST if min(observed) > _LOWEST else min(observed) - 1.0, 101.0)
    axes.set_ylabel("truth held by 95 % regions / %")
    axes.set_title(f"By form of deflection, {panel.title}")
    axes.grid(visible=False, axis="x")


def _reliability(axes: Axes, panel: Panel) -> None:
    axes.plot([0.0, 100.0], [0.0, 100.0], color=QUIET, linewidth=0.8)
    for number, observed in enumerate(panel.curves.values()):
        axes.plot(100.0 * LEVELS, 100.0 * observed, marker=MARKERS[number], markersize=3.0, color=SERIES[number])
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(0.0, 100.0)
    axes.set_xlabel("nominal level / %")
    axes.set_ylabel("truth held / %")
    axes.set_title("Reliability, all forms")
