"""Figure of the Pareto front of position sets: expected volumetric error after compensation (VCE) against machine
minutes.

The figure also shows the designed position set, and existing position sets for comparison (reference sets). Their
machine time is that of the whole run. The sets of the front grow position by position, and the minutes of their
positions are added, so that the designed set may lie beside the front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from agent.figures.style import BLUE, GREEN, INK, ORANGE, from_zero
from agent.planning.design.pareto_front import FrontPoint, grown_front

MINUTES_ADDED = "minutes of the positions added"
"""Words for the machine time of the sets of a front."""


@dataclass(frozen=True)
class ReferenceSet:
    """Existing position set, such as that of the settings, that is compared with a designed position set."""

    name: str
    minutes: float
    vce_um: float


def draw_front(figure: Figure, points: Sequence[FrontPoint], rivals: Sequence[ReferenceSet]) -> None:
    """Draw on the empty `figure` the Pareto front `points`, the designed position set among them, and the existing
    position sets `rivals` for comparison.
    """
    axes = figure.subplots()
    best = grown_front(points)
    label = f"Pareto front, {MINUTES_ADDED}"
    axes.plot([p.minutes for p in best], [p.vce_um for p in best], "-o", color=BLUE, label=label)
    for point in best[:: max(1, len(best) // 8)]:
        axes.annotate(
            f"{point.positions}", (point.minutes, point.vce_um), (3, 5), textcoords="offset points", color=BLUE
        )
    for point in (point for point in points if point.design):
        axes.plot(
            point.minutes, point.vce_um, "s", color=ORANGE, markersize=8, label=f"written: {point.positions} positions"
        )
    for rival in rivals:
        axes.plot(rival.minutes, rival.vce_um, "D", color=GREEN, markersize=7, label=rival.name)
    axes.axhline(_before(points), color=INK, linewidth=0.8, linestyle=":", label="without compensation")
    axes.set_xlabel("machine time / min")
    axes.set_xlim(left=0.0)
    axes.set_title("Expected VCE against machine time (numbers: positions)")
    from_zero(axes, "expected VCE, rigidly aligned / µm")
    axes.legend()


def _before(points: Sequence[FrontPoint]) -> float:
    """Return the VCE in µm without compensation, from the VCE of any point and its reduction."""
    return points[0].vce_um / (1.0 - points[0].valuation / 100.0)
