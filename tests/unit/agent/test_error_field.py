"""The error field on any plane: without a table it is the one that the estimate states, and its table removes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_report import FAMILY, MODEL, OFFSET, RANGES, estimate_of, report_data

from agent.reports.page.error_field import ErrorField
from agent.reports.page.workspace_maps import workspace_maps
from twin.compensation.table import build_table, regular_nodes
from twin.identification import field_uncertainty
from twin.machine.anchor import Anchor


def test_a_plane_is_that_of_the_report_and_the_table_of_the_estimate_removes_the_field() -> None:
    values = FAMILY.draw(np.random.default_rng(5), 1)[0]
    estimate = replace(estimate_of(report_data()), parameters=values)
    measured = np.array([[10.0, 20.0, 250.0], [500.0, 100.0, 400.0]])
    anchor = Anchor(np.array([low for low, _ in RANGES]))
    table = build_table(MODEL, values, regular_nodes(RANGES, (100.0, 100.0, 100.0)), OFFSET, anchor, measured)
    field = ErrorField(estimate, OFFSET, measured, table)

    plane = field.plane(2, 250.0)
    drawn = workspace_maps(estimate, OFFSET, measured).deviation[1]
    assert plane.across == (0, 1)
    assert np.linalg.norm(plane.without_um, axis=-1) == pytest.approx(drawn.length_um, abs=1e-6)
    assert plane.with_um is not None
    assert np.linalg.norm(plane.with_um, axis=-1).max() < 0.1 * drawn.length_um.max()
    assert plane.measured.tolist() == [[10.0, 20.0, 0.0], [500.0, 100.0, 150.0]]
    assert field.largest_um > np.sqrt(drawn.length_um**2 + plane.sigma_um**2).max() - 1e-6

    across = field.plane(0, 1e6)  # beyond the travel: at its end
    assert (across.at_mm, across.across) == (RANGES[0][1], (1, 2))
    points = np.empty((*across.sigma_um.shape, 3))
    points[..., 0] = across.at_mm
    points[..., 1], points[..., 2] = np.meshgrid(*across.nodes_mm, indexing="ij")
    grid = field._grid
    stated = 1e3 * np.linalg.norm(field_uncertainty(estimate, points.reshape(-1, 3), OFFSET, grid), axis=1)
    assert across.sigma_um.ravel() == pytest.approx(stated, rel=0.1)  # interpolated
    assert ErrorField(estimate, OFFSET, measured, None).plane(1, 0.0).with_um is None
