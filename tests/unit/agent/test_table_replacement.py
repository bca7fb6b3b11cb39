"""Rule by which a new table replaces the active one, and its proof."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.errors import GateRefused
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.stand_ins import USUAL_STORE
from agent.probing.measured_balls import no_correction
from agent.results.estimation import EstimationResult, table_grid
from agent.results.facts import Quantity, VolumetricSummary
from agent.results.table_image import image_of, table_as_applied
from agent.results.table_replacement import ExpectedGain, expected_gain, written_parameters
from agent.settings.schema import TableSettings
from twin.arrays import Array
from twin.compensation.table import build_table
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error

errors = st.floats(0.01, 100.0)


@given(kept=errors, new=errors, margin=st.floats(0.0, 0.99))
def test_the_active_table_is_kept_unless_the_new_one_is_better_by_the_margin(
    kept: float, new: float, margin: float
) -> None:
    gain = ExpectedGain(kept, new)
    assert gain.reaches(margin) == (gain.fraction >= margin)
    assert gain.reaches(0.0) == (new <= kept)
    assert ExpectedGain(2.0 * kept, 2.0 * new).fraction == pytest.approx(gain.fraction)
    assert not ExpectedGain(kept, kept).reaches(max(margin, 1e-9))


@pytest.mark.parametrize(
    ("step_mm", "resolution_mm", "share_lost"),
    [(None, 1e-4, (0.0, 0.05)), (None, 1e-2, (0.4, 1.0)), ((4000.0, 4000.0, 4000.0), 1e-4, (0.4, 1.0))],
)
def test_the_gain_of_a_table_is_that_of_the_table_which_the_controller_applies(
    step_mm: tuple[float, float, float] | None, resolution_mm: float, share_lost: tuple[float, float]
) -> None:
    """Counts of 10 µm hold little of errors of some micrometres, and a table of two nodes an axis only its linear
    part."""
    job = load_case(CASE_STUDY)
    model, offset = job.machine.model, job.tool_offset_mm
    for seed in range(3):
        parameters = np.random.default_rng(seed).normal(size=model.size) * job.machine.family.prior_standard_deviation
        nodes, anchor = table_grid(model, TableSettings(step_mm=step_mm))
        table = build_table(model, parameters, nodes, offset, anchor, np.zeros((1, 3)))
        stored = table_as_applied(table, replace(USUAL_STORE, resolution_mm=resolution_mm))
        estimate: Any = SimpleNamespace(model=model, parameters=parameters)
        gain = expected_gain(estimate, 1.0, no_correction, stored.at, offset)
        # the machine with this table at places that are no nodes, without volcal's sums
        low, high = np.array(model.ranges_mm).T
        places = np.random.default_rng(7).uniform(low, high, (4000, 3))
        added = stored.at(places)
        left = added + exact_deviation(model, places + added, offset, parameters)
        arms = (places - places.mean(axis=0)) / 1000.0
        rigid = np.concatenate([np.eye(3) * np.ones((4000, 1, 1)), np.cross(arms[:, None], np.eye(3))], axis=2)
        rigid = rigid.reshape(-1, 6)
        rest = left.reshape(-1) - rigid @ np.linalg.lstsq(rigid, left.reshape(-1))[0]
        true_um = 1e3 * np.sqrt(3.0 * np.mean(rest**2))
        assert gain.new_um == pytest.approx(np.hypot(1.0, true_um), rel=0.15)
        bare_um = np.sqrt(gain.kept_um**2 - 1.0)
        assert share_lost[0] <= true_um / bare_um <= share_lost[1]


def test_a_controller_that_corrects_each_axis_alone_gets_what_it_applies() -> None:
    job = load_case(CASE_STUDY)
    model, offset = job.machine.model, job.tool_offset_mm
    parameters = np.random.default_rng(0).normal(size=model.size) * job.machine.family.prior_standard_deviation
    nodes, anchor = table_grid(model, TableSettings())
    table = build_table(model, parameters, nodes, offset, anchor, np.zeros((1, 3)))
    limits = replace(USUAL_STORE, own_axis_loss_mm=0.1)
    image, stored = image_of(table, limits), table_as_applied(table, limits)
    np.testing.assert_array_equal(limits.resolution_mm * image.counts, stored.corrections)
    for axis in range(3):
        own = np.moveaxis(image.counts[..., axis], axis, 0).reshape(image.shape[axis], -1)
        assert (own == own[:, :1]).all()
        mean = np.moveaxis(table.corrections[..., axis], axis, 0).reshape(image.shape[axis], -1).mean(axis=1)
        np.testing.assert_allclose(limits.resolution_mm * own[:, 0], mean, atol=0.51 * limits.resolution_mm)
    estimate: Any = SimpleNamespace(model=model, parameters=parameters)
    whole, part = (expected_gain(estimate, 1.0, no_correction, one.at, offset) for one in (table, stored))
    assert part.fraction < 0.5 * whole.fraction  # straightness, squareness and rotation stay
    with pytest.raises(GateRefused, match=r"of the table would be lost, 1\.0 µm are accepted"):
        image_of(table, replace(limits, own_axis_loss_mm=1e-3))


def test_the_predicted_error_contains_what_the_controller_does_not_apply() -> None:
    job = load_case(CASE_STUDY)
    model, offset = job.machine.model, job.tool_offset_mm
    parameters = np.random.default_rng(0).normal(size=model.size) * job.machine.family.prior_standard_deviation
    nodes, anchor = table_grid(model, TableSettings())
    table = build_table(model, parameters, nodes, offset, anchor, np.zeros((1, 3)))
    volumetric = VolumetricSummary(Quantity(8.0), Quantity(3.0, 0.5, (2.0, 4.0)), 7.0)
    estimate: Any = SimpleNamespace(model=model, parameters=parameters)
    missing: Any = None
    found = EstimationResult(missing, estimate, volumetric, missing, table, missing)
    assert found.applied_by(USUAL_STORE, offset) is found
    for limits in (replace(USUAL_STORE, own_axis_loss_mm=0.1), replace(USUAL_STORE, resolution_mm=1e-2)):
        stored = table_as_applied(table, limits)
        applied = found.applied_by(limits, offset)
        stated = applied.volumetric.after_aligned
        gain = expected_gain(estimate, found.unknown_um, no_correction, stored.at, offset)
        assert stated.value_um == pytest.approx(gain.new_um, rel=0.05)  # the grids of the travel differ
        assert stated.value_um > 4.0
        assert stated.limits_um is not None
        assert stated.limits_um[0] < stated.value_um < stated.limits_um[1]
        assert applied.unknown_um == pytest.approx(found.unknown_um) == pytest.approx(3.0)


def test_written_parameters_are_those_of_the_table_whatever_rigid_motion_it_contains() -> None:
    job = load_case(CASE_STUDY)
    model, offset = job.machine.model, job.tool_offset_mm
    parameters = np.random.default_rng(1).normal(size=model.size) * job.machine.family.prior_standard_deviation

    def correction(displayed: Array) -> Array:
        turned = np.cross([4e-6, -7e-6, 2e-6], displayed) + np.array([0.02, 0.0, -0.01])
        return np.asarray(turned - deviation_basis(model, displayed, offset) @ parameters)

    difference = written_parameters(model, correction, offset) - parameters
    grid = evaluation_grid(model.ranges_mm, (9, 7, 5))
    field = deviation_basis(model, grid, offset) @ difference
    assert volumetric_error(grid + offset, field).aligned_um < 1e-6
