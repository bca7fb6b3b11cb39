"""Figures of a report, drawn from its data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from agent.figures.style import BLUE, GREEN, INK, MAP_COLOURS, ORANGE, PURPLE, Drawing, Margins
from agent.reports.page.curve_figure import draw_cross_effect, draw_error_curves
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.error_curves import cross_effect_curves, geometric_error_curves
from agent.reports.page.residual_figures import BallResiduals, draw_by_position, draw_distribution
from agent.reports.page.run_figures import draw_position_temperatures, draw_temperatures
from agent.reports.page.workspace_maps import PlaneMap, workspace_maps
from agent.results.facts import ProbeFacts
from twin.arrays import Array

RING_LOOK = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"))
WIDTH_IN = 10.4
GAP_IN = 0.25
BAR_IN = 0.12
ROOM = Margins(right=0.5, bottom=0.38)
HIGHEST_IN = 4.0


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
    return {
        "curves": draw_error_curves(geometric_error_curves(model, values, covariance)),
        "cross": draw_cross_effect(cross) if cross else "",
        "deviation_map": draw_planes("error-map", maps.deviation, "deviation / µm", dots=False),
        "uncertainty_map": draw_planes("vce-map", maps.uncertainty, "σ / µm", dots=True),
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
    drawing = Drawing("qualification", 10.4, 2.4, Margins(right=1.9))
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


def draw_planes(name: str, planes: Sequence[PlaneMap], label: str, *, dots: bool) -> str:
    """Return an SVG with the maps of all `planes` (XY planes of the workspace) side by side. All maps have one colour
    scale, which starts at zero. If `dots` is set, the measured balls are drawn as dots."""
    top = max(float(plane.length_um.max()) for plane in planes) or 1.0
    width, high = _panel_size(planes)
    total = high + ROOM.bottom + ROOM.top
    drawing = Drawing(name, WIDTH_IN, total)
    with drawing as figure:

        def box(left: float, across: float) -> tuple[float, float, float, float]:
            return left / WIDTH_IN, ROOM.bottom / total, across / WIDTH_IN, high / total

        for count, plane in enumerate(planes):
            panel = figure.add_axes(box(ROOM.left + count * (width + GAP_IN), width))
            image = _draw(panel, plane, top, dots)
            panel.set_xlabel("X / mm", labelpad=1)
            if count:
                panel.tick_params(labelleft=False)
            else:
                panel.set_ylabel("Y / mm")
        end = ROOM.left + len(planes) * (width + GAP_IN)
        bar = figure.colorbar(image, cax=figure.add_axes(box(end - 0.1, BAR_IN)))
        bar.set_label(label)
        bar.outline.set_linewidth(0.4)
    return drawing.svg()


def _draw(panel: Axes, plane: PlaneMap, top: float, dots: bool) -> AxesImage:
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
    panel.contour(plane.x_mm, plane.y_mm, plane.length_um.T, 6, colors="white", linewidths=0.35, alpha=0.7)
    if dots and len(plane.measured):
        panel.plot(plane.measured[:, 0], plane.measured[:, 1], ".", color="white", markersize=1.6, alpha=0.9)
    panel.set_xlim(extent[:2])
    panel.set_ylim(extent[2:])
    panel.set_title(f"Z = {plane.z_mm:g} mm", loc="left", pad=3)
    panel.grid(visible=False)
    panel.spines[:].set_visible(True)
    panel.spines[:].set_edgecolor(INK)
    panel.locator_params(nbins=4)
    return image


def _panel_size(planes: Sequence[PlaneMap]) -> tuple[float, float]:
    """Return the width and height in inches with which panels of equal X and Y scale fill the page."""
    plane = planes[0]
    ratio = float(np.ptp(plane.y_mm) / np.ptp(plane.x_mm))
    width = (WIDTH_IN - ROOM.left - ROOM.right - BAR_IN) / len(planes) - GAP_IN
    high = min(width * ratio, HIGHEST_IN)
    return high / ratio, high
