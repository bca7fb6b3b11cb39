"""Which figures a report holds, drawn from its data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.report.curve_figure import draw_cross_effect, draw_error_curves
from agent.report.data import ReportData
from agent.report.error_curves import cross_effect_curves, geometric_error_curves
from agent.report.map_figure import draw_planes
from agent.report.probe_figure import draw_qualification
from agent.report.residual_figures import BallResiduals, draw_by_position, draw_distribution
from agent.report.run_figures import draw_position_temperatures, draw_temperatures
from agent.report.workspace_maps import workspace_maps

Array = NDArray[np.float64]


def report_figures(data: ReportData) -> dict[str, str]:
    """SVG by the name that the page's template gives it; an empty text where there is nothing to draw."""
    estimate, seen = data.estimate, data.observations
    model, values, covariance = estimate.model, estimate.parameters, estimate.covariance
    residuals = ball_residuals(data)
    maps = workspace_maps(estimate, data.tool_offset, seen.axis_positions)
    cross = cross_effect_curves(model, values, covariance)
    traces = data.run.temperatures
    return {
        "curves": draw_error_curves(geometric_error_curves(model, values, covariance)),
        "cross": draw_cross_effect(cross) if cross else "",
        "deviation_map": draw_planes("error-map", maps.deviation, "deviation / µm", dots=False),
        "uncertainty_map": draw_planes("vce-map", maps.uncertainty, "std. deviation / µm", dots=True),
        "residuals_by_position": draw_by_position(residuals),
        "residual_distribution": draw_distribution(residuals),
        "qualification": draw_qualification(data.run.probe) if data.run.probe and data.run.probe.rings else "",
        "temperatures": draw_temperatures(traces)
        if traces
        else draw_position_temperatures(seen.position, seen.temperature_c),
    }


def ball_residuals(data: ReportData) -> BallResiduals:
    """Residuals in µm and in standard deviations, with what was rejected and where a new station begins."""
    seen, estimate = data.observations, data.estimate
    gone = set(estimate.rejected)
    keys = zip(seen.position.tolist(), seen.ball.tolist(), seen.tool.tolist(), strict=True)
    kept = np.array([key not in gone for key in keys])
    stations = [position.station for position in data.positions]
    return BallResiduals(
        position=seen.position,
        ball=seen.ball,
        residual_um=1e3 * estimate.residuals_mm,
        standardised=estimate.residuals_mm / _expected_spread(data, int(kept.sum())),
        kept=kept,
        station_starts=tuple(count for count in range(1, len(stations)) if stations[count] != stations[count - 1]),
    )


def _expected_spread(data: ReportData, kept: int) -> Array:
    """(n, 3) mm: touch noise as found, less what the fit takes up with its poses and parameters."""
    sigma = np.sqrt(np.einsum("nii->ni", data.observations.covariance)) * data.estimate.scales.noise
    return np.asarray(sigma * np.sqrt(data.estimate.degrees_of_freedom / (3.0 * kept)))
