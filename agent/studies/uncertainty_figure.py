"""Figure of the study `uncertainty`. It shows how much each influence, such as touch noise or drift, contributes to the
error that remains after compensation, the distribution and a map of this error, and the standard uncertainties of the
21 geometric errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.figures.style import BLUE, GRID, INK, ORANGE, QUIET, SKY, from_zero
from agent.studies.monte_carlo import ErrorSample
from agent.studies.plane_map import PLANE_SHAPE, Plane, draw_plane, map_nodes
from twin.machine.error_model import motion_uncertainty
from twin.machine.volumetric import VolumetricRms
from twin.uncertainty.error_budget import ErrorBudget
from twin.units import UM_PER_MM

MICRO = 1e6
STANDARD_ERRORS = 2.0
ROTATING = "ABC"


@dataclass(frozen=True, eq=False)
class InfluenceResult:
    """Contribution of one influence, such as touch noise, to the error that remains after compensation. `closed` is the
    contribution computed in closed form. `simulated` is the result of a simulation with this influence alone, or None
    if the influence was not simulated.
    """

    name: str
    closed: VolumetricRms
    simulated: ErrorSample | None


@dataclass(frozen=True, eq=False)
class UncertaintyResult:
    """Results of the study `uncertainty`. `parts` contains one result for each influence on the error that remains
    after compensation, such as touch noise. `budget` is the closed-form error budget with all influences. `together`
    contains the errors after compensation of the machines that were simulated with all influences.
    """

    parts: tuple[InfluenceResult, ...]
    budget: ErrorBudget
    together: ErrorSample


def draw(figure: Figure, found: UncertaintyResult) -> None:
    rows = figure.add_gridspec(2, 1)
    upper = rows[0].subgridspec(1, 2, width_ratios=(1.0, 1.3))
    lower = rows[1].subgridspec(1, 3, width_ratios=(1.0, 1.0, 1.3))
    _draw_contributions(figure.add_subplot(upper[0]), found)
    _draw_map(figure, figure.add_subplot(upper[1]), found.budget)
    _draw_distribution(figure.add_subplot(lower[0]), found)
    _draw_motions((figure.add_subplot(lower[1]), figure.add_subplot(lower[2])), found.budget)


def _upper_end_um(bar: InfluenceResult) -> float:
    """Return the upper end of the interval of the simulated contribution in µm; 0 if it was not simulated."""
    if bar.simulated is None:
        return 0.0
    return bar.simulated.expected.aligned_um + STANDARD_ERRORS * bar.simulated.standard_error.aligned_um


def _draw_contributions(axes: Axes, found: UncertaintyResult) -> None:
    """Draw the contributions with the largest at the top and the total at the bottom. The squares of the contributions
    add up to the square of the total."""
    ordered = sorted(found.parts, key=lambda part: part.closed.aligned_mm)
    bars = [InfluenceResult("all together", found.budget.expected, found.together), *ordered]
    coordinates = np.arange(len(bars))
    lengths = np.array([bar.closed.aligned_um for bar in bars])
    axes.barh(coordinates[:1], lengths[:1], color=INK, height=0.62)
    axes.barh(coordinates[1:], lengths[1:], color=BLUE, height=0.62, label="closed form")
    simulated = [
        (coordinate, bar.simulated)
        for coordinate, bar in zip(coordinates, bars, strict=True)
        if bar.simulated is not None
    ]
    axes.errorbar(
        [spread.expected.aligned_um for _, spread in simulated],
        [coordinate for coordinate, _ in simulated],
        xerr=[STANDARD_ERRORS * spread.standard_error.aligned_um for _, spread in simulated],
        fmt="D",
        color=ORANGE,
        markersize=3.5,
        capsize=2.5,
        linewidth=1.0,
        label="simulated alone,\n± 2 standard errors",
    )
    for coordinate, bar in zip(coordinates, bars, strict=True):
        end = max(bar.closed.aligned_um, _upper_end_um(bar))
        text = f"{bar.closed.aligned_um:.2f}"
        axes.annotate(text, (end, coordinate), (6.0, 0.0), textcoords="offset points", va="center")
    axes.set_yticks(coordinates, [bar.name for bar in bars])
    axes.set_xlim(0.0, 1.15 * max(lengths.max(), *(_upper_end_um(bar) for bar in bars)))
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("root mean square VCE, aligned / µm")
    axes.set_title("Contributions: their squares add up")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.14))


def _draw_distribution(axes: Axes, found: UncertaintyResult) -> None:
    machines = UM_PER_MM * np.sort(found.together.aligned_mm)
    share = 100.0 * (np.arange(len(machines)) + 1.0) / len(machines)
    axes.step(machines, share, where="post", color=ORANGE, label=f"{len(machines)} simulated")
    distribution = found.budget.distribution
    low, high = distribution.limits(0.998)
    lengths_mm = np.linspace(low.aligned_mm, high.aligned_mm, 80)
    below = [100.0 * distribution.aligned.at_most(length**2) for length in lengths_mm.tolist()]
    axes.plot(UM_PER_MM * lengths_mm, below, color=BLUE, linestyle="--", label="closed form")
    first, last = distribution.limits()
    axes.axvspan(first.aligned_um, last.aligned_um, color=SKY, alpha=0.18, linewidth=0.0, label="95 % limits")
    axes.axvline(distribution.median.aligned_um, color=QUIET, linewidth=0.9, linestyle=":", label="median")
    axes.set_xlabel("VCE of a machine, aligned / µm")
    from_zero(axes, "share of the machines below / %")
    axes.set_ylim(0.0, 105.0)
    axes.set_title("Distribution over machines")
    axes.legend(loc="lower right", bbox_to_anchor=(1.03, 0.05))


def _draw_map(figure: Figure, axes: Axes, budget: ErrorBudget) -> None:
    x_mm, y_mm, height_mm = map_nodes(budget.field.model.ranges_mm)
    points = np.stack(np.meshgrid(x_mm, y_mm, [height_mm], indexing="ij"), axis=-1).reshape(-1, 3)
    length_um = UM_PER_MM * np.linalg.norm(budget.field_uncertainty(points, aligned=True), axis=1)
    plane = Plane(f"Field left at Z = {height_mm:g} mm", x_mm, y_mm, length_um.reshape(PLANE_SHAPE))
    image = draw_plane(axes, plane, float(length_um.max()))
    bar = figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.7)
    bar.set_label("expected root mean square, aligned / µm")


def _draw_motions(panels: tuple[Axes, Axes], budget: ErrorBudget) -> None:
    """Draw the standard uncertainties of displacements in µm, and of rotations and squareness in µrad, as rms over the
    range of the axis, before and after identification."""
    model = budget.field.form.model
    family = motion_uncertainty(model, budget.field.family_moments)
    left = motion_uncertainty(model, budget.total)
    turning = {name: name[1] in ROTATING or not name.startswith("E") for name in family}
    for axes, rotations, factor, title, unit in (
        (panels[0], False, UM_PER_MM, "Displacements left open", "µm"),
        (panels[1], True, MICRO, "Rotations and squareness left open", "µrad"),
    ):
        names = [name for name in family if turning[name] is rotations]
        _draw_bars(axes, names, family, left, factor)
        axes.set_title(title)
        from_zero(axes, f"standard uncertainty / {unit}")
    handles, labels = panels[1].get_legend_handles_labels()
    panels[1].legend(handles, labels, loc="upper left", ncols=2)
    panels[1].set_ylim(0.0, 1.18 * panels[1].get_ylim()[1])


def _draw_bars(
    axes: Axes, names: list[str], family: Mapping[str, float], left: Mapping[str, float], factor: float
) -> None:
    coordinates = np.arange(len(names))
    before = [factor * family[name] for name in names]
    after = [factor * left[name] for name in names]
    axes.bar(coordinates, before, color=GRID, edgecolor=QUIET, linewidth=0.6, width=0.78, label="family")
    axes.bar(coordinates, after, color=BLUE, width=0.5, label="after identification")
    axes.set_xticks(coordinates, names, rotation=60.0)
    axes.grid(visible=False, axis="x")
