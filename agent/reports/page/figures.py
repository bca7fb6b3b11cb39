"""Figures of a report, drawn from its data."""

from __future__ import annotations

import numpy as np

from agent.reports.page.curve_figure import draw_cross_effect, draw_error_curves
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.error_curves import cross_effect_curves, geometric_error_curves
from agent.reports.page.map_figure import draw_planes
from agent.reports.page.probe_figure import draw_qualification
from agent.reports.page.residual_figures import BallResiduals, draw_by_position, draw_distribution
from agent.reports.page.run_figures import draw_position_temperatures, draw_temperatures
from agent.reports.page.workspace_maps import workspace_maps
from twin.arrays import Array


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
