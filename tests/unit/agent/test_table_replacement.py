"""Rule by which a new table replaces the active one, and its proof."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.planning.case_file import CASE_STUDY, load_case
from agent.results.table_replacement import ExpectedGain, written_parameters
from twin.arrays import Array
from twin.machine.forward_model import deviation_basis
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
