"""Residual fields in the frame of a workpiece, against explicit rigid motions of the exact field on the grid."""

from __future__ import annotations

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured

from twin.arrays import Array
from twin.identification.options import Options
from twin.machine.anchor import Anchor
from twin.machine.deflection import CASE_STUDY_NODES, cantilever_deflection
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, rms
from twin.uncertainty.error_budget import error_budget_of_form
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions
from twin.uncertainty.work_frame import WorkFrameForm

GRID = evaluation_grid(RANGES, (7, 5, 5))
MIDDLE = np.mean(RANGES, axis=1)
DEFLECTION = cantilever_deflection(*CASE_STUDY_NODES)
MODEL, FAMILY = case_study(5)
ASSUMPTIONS = TruthAssumptions(case_study(7)[1], DEFLECTION)
FIELD = FieldForm.build(MODEL, ASSUMPTIONS, GRID, TOOL)
NANOMETRE = 1e-6  # mm


def machine(seed: int) -> tuple[Array, Array]:
    """Return parameters of a true machine, and the same as parameters of the joint model."""
    drawn = ASSUMPTIONS.family.draw(np.random.default_rng(seed), 1)[0]
    joint = np.zeros(FIELD.size)
    joint[FIELD.true_indices] = drawn
    return drawn, joint


def field_at(parameters: Array, points: Array) -> Array:
    return np.asarray(exact_deviation(ASSUMPTIONS.family.model, points, TOOL, parameters) + DEFLECTION.at(points))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_work_offset_takes_the_field_at_its_point_off(seed: int) -> None:
    drawn, joint = machine(seed)
    left = field_at(drawn, GRID) - field_at(drawn, MIDDLE[None, :])
    assert WorkFrameForm.zeroed_at(FIELD, MIDDLE).values_mm(joint[None, :])[0] == pytest.approx(
        rms(left), abs=NANOMETRE
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_known_places_take_the_fitted_motion_off(seed: int) -> None:
    drawn, joint = machine(seed)
    low, high = np.transpose(RANGES)
    balls = np.random.default_rng(seed).uniform(low, high, (40, 3))
    motions = [np.tile(np.eye(3)[axis], (40, 1)).ravel() for axis in range(3)]
    motions += [np.cross(np.eye(3)[axis], balls / 1e3).ravel() for axis in range(3)]
    found = np.linalg.lstsq(np.transpose(motions), field_at(drawn, balls).ravel(), rcond=None)[0]
    left = field_at(drawn, GRID) - found[:3] - np.cross(found[3:], GRID / 1e3)
    assert WorkFrameForm.fitted_at(FIELD, balls).values_mm(joint[None, :])[0] == pytest.approx(rms(left), abs=NANOMETRE)


def test_a_frame_at_the_whole_grid_is_the_rigid_alignment() -> None:
    joint = machine(1)[1][None, :]
    aligned_mm = FIELD.form.values(joint)[1]
    assert WorkFrameForm.fitted_at(FIELD, GRID).values_mm(joint) == pytest.approx(aligned_mm, rel=1e-9)


def test_no_frame_is_better_than_the_best_alignment() -> None:
    joint = np.array([machine(seed)[1] for seed in range(5)])
    frames = (WorkFrameForm.zeroed_at(FIELD, MIDDLE), WorkFrameForm.aligned_by(FIELD, Anchor(MIDDLE)))
    aligned_mm = FIELD.form.values(joint)[1]
    assert all((frame.values_mm(joint) >= aligned_mm - NANOMETRE).all() for frame in frames)


def test_a_rigid_motion_of_the_machine_does_not_count() -> None:
    """The deflection with a rotation and a shift added has the same errors in the work frame, and others as defined."""
    points = np.stack(np.meshgrid(*CASE_STUDY_NODES, indexing="ij"), axis=-1)
    turned = DEFLECTION.values + np.array([0.01, -0.02, 0.03]) + np.cross([2e-5, -1e-5, 3e-5], points)
    moved = FieldForm.build(
        MODEL, TruthAssumptions(ASSUMPTIONS.family, type(DEFLECTION)(*DEFLECTION.nodes, turned)), GRID, TOOL
    )
    before, after = (WorkFrameForm.aligned_by(field, Anchor(MIDDLE)) for field in (FIELD, moved))
    assert after.uncompensated_mm() == pytest.approx(before.uncompensated_mm(), rel=1e-9)
    assert moved.uncompensated().raw_mm > 2.0 * FIELD.uncompensated().raw_mm


def test_drawn_machines_have_the_expected_square() -> None:
    artefact = bar(7, 15.0, 0.8e-3)
    seen = measured("S3", 3, artefact, lambda at, _: np.zeros_like(at), np.random.default_rng(0), sigma_mm=1e-3)
    options = Options(estimate_scales=False, outliers="none")
    budget = error_budget_of_form(FIELD, FAMILY, artefact, seen, options)
    rng = np.random.default_rng(5)
    machines = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (6000, len(FIELD.true_indices)))
    left = budget.draw_residuals(machines, rng)
    frame = WorkFrameForm.aligned_by(FIELD, Anchor(MIDDLE))
    assert np.sqrt(np.mean(frame.values_mm(left) ** 2)) == pytest.approx(frame.expected_mm(budget), rel=0.02)
    raw_mm, aligned_mm = FIELD.form.values(left)
    assert np.sqrt(np.mean(raw_mm**2)) == pytest.approx(budget.expected.raw_mm, rel=0.02)
    assert np.sqrt(np.mean(aligned_mm**2)) == pytest.approx(budget.expected.aligned_mm, rel=0.02)
