"""Figures of a report, drawn from its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from agent.figures.style import BLUE, GREEN, INK, MAP_COLOURS, ORANGE, PURPLE, REPORT_WIDTH_IN, Drawing, Margins
from agent.reports.page.curve_figure import draw_cross_effect, draw_error_curves
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.error_curves import cross_effect_curves, geometric_error_curves
from agent.reports.page.residual_figures import BallResiduals, draw_by_position, draw_distribution
from agent.reports.page.run_figures import draw_position_temperatures, draw_temperatures
from agent.reports.page.workspace_maps import PlaneMap, workspace_maps
from agent.results.facts import ProbeFacts
from twin.arrays import Array

RING_LOOK = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"))
GAP_IN = 0.25
BAR_IN = 0.12
ROOM = Margins(right=0.5, bottom=0.38)
HIGHEST_IN = 4.0
_LONG = 0.6
"""Width of a plane relative to its length below which planes are drawn below each other."""


def report_figures(data: ReportData) -> dict[str, str]:
    """Return a mapping from the name of each figure in the report's HTML template to its SVG. The SVG is an empty text
    if there is nothing to draw."""
    traces, probe, identification = data.run.temperatures, data.run.probe, data.identification
    figures = {
        "qualification": draw_qualification(probe) if probe and probe.rings else "",
        "temperatures": draw_temperatures(traces, data.run.drifts_um) if traces else "",
        "trend": data.run.trend,
    }
    if identification is None:
        return figures
    seen = identification.observations
    if not traces:
        figures["temperatures"] = draw_position_temperatures(seen.position, seen.temperature_c)
    return {**figures, **_of_estimate(identification, np.asarray(data.tool_offset))}


def _of_estimate(identification: IdentificationData, tool_offset: Array) -> dict[str, str]:
    estimate = identification.estimate
    model, values, covariance = estimate.model, estimate.parameters, estimate.covariance
    residuals = ball_residuals(identification)
    maps = workspace_maps(estimate, tool_offset, identification.observations.axis_positions)
    cross = cross_effect_curves(model, values, covariance)
    # without the table, the identified deviation comes on top of what stays unknown
    before = [
        replace(known, length_um=np.hypot(known.length_um, unknown.length_um))
        for known, unknown in zip(maps.deviation, maps.uncertainty, strict=True)
    ]
    middle = len(before) // 2
    return {
        "curves": draw_error_curves(geometric_error_curves(model, values, covariance)),
        "cross": draw_cross_effect(cross) if cross else "",
        "map_pair": draw_pair(before[middle], maps.uncertainty[middle]),
        "maps": draw_all(before, maps.uncertainty),
        "residuals_by_position": draw_by_position(residuals),
        "residual_distribution": draw_distribution(residuals),
    }


def ball_residuals(identification: IdentificationData) -> BallResiduals:
    """Return the residuals of all balls measured for `identification`, in the form in which the figures of the
    residuals need them."""
    seen, estimate = identification.observations, identification.estimate
    rejected = set(estimate.rejected)
    keys = zip(seen.position.tolist(), seen.ball.tolist(), seen.tool.tolist(), strict=True)
    accepted = np.array([key not in rejected for key in keys])
    stations = [position.station for position in identification.positions]
    return BallResiduals(
        position=seen.position,
        ball=seen.ball,
        residual_um=1e3 * identification.residuals_mm,
        standardised=identification.residuals_mm / _expected_spread(identification, int(accepted.sum())),
        accepted=accepted,
        station_starts=tuple(count for count in range(1, len(stations)) if stations[count] != stations[count - 1]),
    )


def _expected_spread(identification: IdentificationData, accepted: int) -> Array:
    """Return the expected standard deviation of the residuals, (n, 3) in mm.

    It is the estimated touch noise, reduced for the degrees of freedom used by poses and parameters. `accepted` is the
    number of accepted balls.
    """
    sigma = np.sqrt(np.einsum("nii->ni", identification.observations.covariance)) * identification.estimate.scales.noise
    return np.asarray(sigma * np.sqrt(identification.estimate.degrees_of_freedom / (3.0 * accepted)))


def draw_qualification(probe: ProbeFacts) -> str:
    """Return an SVG of the stylus qualification with one colour for each latitude on the ball. Points show the
    residuals of the touches. Lines show the map of the pretravel, which is subtracted from the touches of the run."""
    drawing = Drawing("qualification", REPORT_WIDTH_IN, 2.3, Margins(right=1.9))
    with drawing as figure:
        panel = figure.subplots()
        for count, ring in enumerate(probe.rings):
            colour, marker = RING_LOOK[count % len(RING_LOOK)]
            panel.plot(
                ring.angle_deg, ring.residual_um, marker, color=colour, markersize=4, label=_name(ring.latitude_deg)
            )
            if ring.map_um.size:
                panel.plot(ring.map_angle_deg, ring.map_um, color=colour, linewidth=0.9)
        panel.axhline(0.0, color=INK, linewidth=0.6)
        panel.set_xlim(0.0, 360.0)
        panel.set_xticks(range(0, 361, 45))
        panel.set_xlabel("angle about the stylus / °")
        panel.set_ylabel("residual / µm")
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    return drawing.svg()


def _name(latitude_deg: float) -> str:
    named = {90.0: "pole", 0.0: "equator"}
    return named.get(latitude_deg, f"{latitude_deg:.0f}° above the equator")


def draw_pair(before: PlaneMap, after: PlaneMap) -> str:
    """Return an SVG with one plane of the workspace without and with the table, on one colour scale from zero. Planes
    that are much longer than wide are drawn below each other, others side by side."""
    stacked = _ratio(before) < _LONG
    shape = (2, 1) if stacked else (1, 2)
    titled = [("without table", before), ("with table", after)]
    return _draw_grid("error-map", titled, shape, labelled=True)


def draw_all(before: Sequence[PlaneMap], after: Sequence[PlaneMap]) -> str:
    """Return an SVG with all planes of the workspace without and with the table, on one colour scale from zero."""
    heights = len(before)
    pairs = [(f"without table, Z = {plane.z_mm:g} mm", plane) for plane in before]
    others = [(f"with table, Z = {plane.z_mm:g} mm", plane) for plane in after]
    if _ratio(before[0]) < _LONG:
        rows = [one for pair in zip(pairs, others, strict=True) for one in pair]
        return _draw_grid("error-maps", rows, (heights, 2), labelled=False)
    return _draw_grid("error-maps", [*pairs, *others], (2, heights), labelled=False)


def _ratio(plane: PlaneMap) -> float:
    return float(np.ptp(plane.y_mm) / np.ptp(plane.x_mm))


def _draw_grid(name: str, planes: Sequence[tuple[str, PlaneMap]], shape: tuple[int, int], *, labelled: bool) -> str:
    """Return an SVG with titled planes in rows and columns. Contour lines have their values if `labelled` is set, and
    the measured balls are drawn as dots."""
    rows, columns = shape
    top = max(float(plane.length_um.max()) for _, plane in planes) or 1.0
    room = REPORT_WIDTH_IN - ROOM.left - ROOM.right - BAR_IN
    width, ratio = room / columns - GAP_IN, _ratio(planes[0][1])
    high = min(width * ratio, HIGHEST_IN)
    width = high / ratio
    step = high + ROOM.bottom + ROOM.top
    total = rows * step
    drawing = Drawing(name, REPORT_WIDTH_IN, total)
    with drawing as figure:

        def box(left: float, bottom: float, across: float, up: float) -> tuple[float, float, float, float]:
            return left / REPORT_WIDTH_IN, bottom / total, across / REPORT_WIDTH_IN, up / total

        for count, (title, plane) in enumerate(planes):
            row, column = divmod(count, columns)
            bottom = total - (row + 1) * step + ROOM.bottom
            panel = figure.add_axes(box(ROOM.left + column * (width + GAP_IN), bottom, width, high))
            image = _draw(panel, plane, top, labelled=labelled)
            panel.set_title(title, loc="left", pad=3)
            panel.set_xlabel("X / mm", labelpad=1)
            if column:
                panel.tick_params(labelleft=False)
            else:
                panel.set_ylabel("Y / mm")
        end = ROOM.left + columns * (width + GAP_IN) - 0.1
        bar = figure.colorbar(image, cax=figure.add_axes(box(end, ROOM.bottom, BAR_IN, total - ROOM.bottom - ROOM.top)))
        bar.set_label("expected error / µm")
        bar.outline.set_linewidth(0.4)
    return drawing.svg()


def _draw(panel: Axes, plane: PlaneMap, top: float, *, labelled: bool) -> AxesImage:
    extent = (plane.x_mm[0], plane.x_mm[-1], plane.y_mm[0], plane.y_mm[-1])
    image = panel.imshow(
        plane.length_um.T,
        origin="lower",
        extent=extent,
        cmap=MAP_COLOURS,
        vmin=0.0,
        vmax=top,
        interpolation="bilinear",
        aspect="equal",
    )
    levels = MaxNLocator(8).tick_values(0.0, top)
    lines = panel.contour(plane.x_mm, plane.y_mm, plane.length_um.T, levels, colors="white", linewidths=0.45, alpha=0.8)
    if labelled:
        panel.clabel(lines, fontsize=7, inline_spacing=2, fmt="%g")
    if len(plane.measured):
        panel.plot(plane.measured[:, 0], plane.measured[:, 1], ".", color="white", markersize=1.6, alpha=0.9)
    panel.set_xlim(extent[:2])
    panel.set_ylim(extent[2:])
    panel.grid(visible=False)
    panel.spines[:].set_visible(True)
    panel.spines[:].set_edgecolor(INK)
    panel.locator_params(nbins=5)
    return image
