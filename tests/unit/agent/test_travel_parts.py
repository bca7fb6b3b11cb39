"""Volumetric error inside and outside the measured region: its record, its rows and its quadratic forms."""

from __future__ import annotations

import json
from functools import cache
from itertools import product

import numpy as np
import pytest

from agent.cli.printing import travel_rows
from agent.planning.case_file import CASE_STUDY, load_case
from agent.results.estimation import travel_parts, volumetric_summary
from agent.results.travel_parts import TravelPart, TravelParts
from twin.compensation.table import MeasuredRegion
from twin.design.measurement_setup import AS_STATED
from twin.identification import Estimate, expected_rms, field_uncertainty, identify, predicted_vce, regional_forms
from twin.machine.volumetric import evaluation_grid

PART = TravelPart(0.6, 7.9, (7.1, 8.8), 7.7, 1.7, (1.2, 2.4))
COARSE = (9, 5, 5)


@cache
def found() -> tuple[Estimate, np.ndarray, np.ndarray]:
    """Return the estimate of a planned measurement, the tool offset and the measured axis positions."""
    job = load_case(CASE_STUDY)
    seen = job.procedure.plan(job.positions).observations
    estimate = identify(job.machine.model, seen, job.artefact, job.machine.family, AS_STATED)
    return estimate, job.tool_offset_mm, seen.axis_positions


def test_the_parts_are_read_back_as_they_were_recorded() -> None:
    for parts in (TravelParts(PART, None), TravelParts(PART, PART)):
        assert TravelParts.from_record(json.loads(json.dumps(parts.as_record()))) == parts


def test_a_part_without_points_has_no_row() -> None:
    rows = travel_rows(TravelParts(PART, None))
    assert [name for name, _ in rows] == ["VE → VCE where measured"]
    assert rows[0][1] == "7.90 → 1.70 µm (95 %: 1.20 to 2.40), 60 % of the travel"


def test_both_parts_add_up_to_the_whole_travel() -> None:
    estimate, offset, measured = found()
    parts = travel_parts(estimate, offset, measured)
    assert parts.measured is not None
    assert parts.unmeasured is not None
    both = (parts.measured, parts.unmeasured)
    grid = evaluation_grid(estimate.model.ranges_mm)
    assert parts.measured.share == pytest.approx(MeasuredRegion.around(measured).contains(grid).mean())
    whole = volumetric_summary(estimate, offset)
    assert whole.after_aligned.value_um == pytest.approx(predicted_vce(estimate, grid, offset).aligned_um, rel=1e-9)
    for name, expected_um in (
        ("estimated_ve_um", whole.before_aligned.value_um),
        ("table_ve_um", whole.table_ve_um),
        ("predicted_vce_um", whole.after_aligned.value_um),
    ):
        squares = sum(part.share * getattr(part, name) ** 2 for part in both)
        assert np.sqrt(squares) == pytest.approx(expected_um, rel=1e-6, abs=1e-6), name
    for part in both:
        for value, (lower, upper) in (
            (part.estimated_ve_um, part.estimated_ve_limits_um),
            (part.predicted_vce_um, part.predicted_vce_limits_um),
        ):
            assert lower < value < upper


def test_a_part_that_is_the_whole_travel_has_the_figures_of_the_whole() -> None:
    estimate, offset, _ = found()
    corners = np.array(list(product(*estimate.model.ranges_mm)))
    parts, whole = travel_parts(estimate, offset, corners), volumetric_summary(estimate, offset)
    part = parts.measured
    assert parts.unmeasured is None
    assert part is not None
    assert part.share == 1.0
    for value, limits, of_whole in (
        (part.estimated_ve_um, part.estimated_ve_limits_um, whole.before_aligned),
        (part.predicted_vce_um, part.predicted_vce_limits_um, whole.after_aligned),
    ):
        assert value == pytest.approx(of_whole.value_um, rel=1e-9)
        assert limits == pytest.approx(of_whole.limits_um, rel=1e-6)


@pytest.mark.parametrize("most", [True, False])
def test_the_error_of_a_part_is_the_mean_over_its_points(most: bool) -> None:
    estimate, offset, _ = found()
    grid = evaluation_grid(estimate.model.ranges_mm, COARSE)
    inside = (grid[:, 0] < 3200.0) == most
    expected = np.square(field_uncertainty(estimate, grid, offset, aligned_over=grid)).sum(axis=1)
    forms = regional_forms(estimate, grid, inside, offset)
    for form, mask in zip(forms, (inside, ~inside), strict=True):
        assert form is not None
        assert expected_rms(estimate, form) == pytest.approx(np.sqrt(expected[mask].mean()), rel=1e-9)


def test_a_part_without_points_has_no_form() -> None:
    estimate, offset, _ = found()
    grid = evaluation_grid(estimate.model.ranges_mm, COARSE)
    first, second = regional_forms(estimate, grid, np.ones(len(grid), dtype=bool), offset)
    assert second is None
    assert first is not None
    assert expected_rms(estimate, first) == pytest.approx(predicted_vce(estimate, grid, offset).aligned_mm, rel=1e-9)
