"""Figure of the study of sequential calibrations: VCE against machine time, and coverage of the stated limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BAND_OPACITY, GREEN, INK, MARKERS, QUIET, SERIES
from twin.design.relaxed_design import InformationBound
from twin.uncertainty.coverage import ObservedCoverage
from twin.units import UM_PER_MM

BAND = (93.0, 97.0)
_LOWEST = 70.0
_APART = 0.16  # horizontal distance between the targets of one group


@dataclass(frozen=True)
class VceCurve:
    """True VCE after the first positions of one way to choose them: numbers of positions, mean minutes, root mean
    square of the true VCE in µm over the machines, and the share of the machines whose stated limits contain it."""

    name: str
    positions: tuple[int, ...]
    minutes: tuple[float, ...]
    vce_um: tuple[float, ...]
    held: tuple[float, ...]

    def as_json(self) -> dict[str, object]:
        return {name: list(values) for name, values in vars(self).items() if name != "name"}


def draw(
    figure: Figure,
    curves: Sequence[VceCurve],
    expected: Sequence[tuple[float, float]],
    bounds: Sequence[InformationBound],
    coverage: Mapping[str, Mapping[str, ObservedCoverage]],
) -> None:
    """Draw the true VCE against minutes for each way to choose the positions, with the `expected` VCE in µm of designed
    sets by minutes and its lower `bounds` and, beside it, the observed coverage by form of deflection for each
    target."""
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    _draw_curves(left, curves)
    left.plot(*zip(*expected, strict=True), color=INK, linewidth=0.9, linestyle=":", label="expected of designed sets")
    minutes = [one.time for one in bounds]
    lowest = [UM_PER_MM * one.vce_mm for one in bounds]
    left.plot(minutes, lowest, color=INK, linewidth=0.9, label="information bound, expected")
    left.legend()
    _draw_coverage(right, coverage)


def _draw_curves(axes: Axes, curves: Sequence[VceCurve]) -> None:
    for number, curve in enumerate(curves):
        axes.plot(
            curve.minutes,
            curve.vce_um,
            marker=MARKERS[number],
            color=SERIES[number],
            label=f"{curve.name} ({curve.positions[0]} to {curve.positions[-1]} positions)" if curve.positions else "",
        )
    axes.set_xlabel("minutes of the positions, without checks and proof")
    axes.set_ylabel("true VCE, rms over the machines / µm")
    axes.set_ylim(bottom=0.0)
    axes.set_title("Error that remains")


def _draw_coverage(axes: Axes, coverage: Mapping[str, Mapping[str, ObservedCoverage]]) -> None:
    axes.axhspan(*BAND, color=GREEN, alpha=BAND_OPACITY, linewidth=0.0)
    axes.axhline(95.0, color=QUIET, linewidth=0.8)
    groups = list(dict.fromkeys(name for shares in coverage.values() for name in shares))
    for number, (ending, shares) in enumerate(coverage.items()):
        at = [groups.index(name) + _APART * (number - 0.5 * (len(coverage) - 1)) for name in shares]
        axes.errorbar(
            at,
            [100.0 * one.observed for one in shares.values()],
            [100.0 * one.standard_error for one in shares.values()],
            fmt=MARKERS[number],
            color=SERIES[number],
            elinewidth=0.9,
            label=ending,
        )
    axes.axvline(groups.index("all") - 0.5, color=INK, linewidth=0.7)
    axes.set_xticks(np.arange(len(groups)), groups, rotation=30)
    observed = [100.0 * one.observed for shares in coverage.values() for one in shares.values()]
    axes.set_ylim(min(_LOWEST, *observed) - 1.0, 101.0)
    axes.set_ylabel("true VCE within its stated limits / %")
    axes.set_title("Coverage at the end of the run")
    axes.grid(visible=False, axis="x")
    axes.legend(loc="lower center")
