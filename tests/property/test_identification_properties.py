"""Properties that hold for any sphere, any table anchor and any placement of the artefact."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin.artefact.artefact import ball_bar
from twin.artefact.observations import Observations
from twin.artefact.sphere_fit import fit_sphere
from twin.compensation.table import build_table, regular_nodes
from twin.identification import Options, identify
from twin.identification.poses import RowLayout, rigid_poses
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.volumetric import align_rigidly, evaluation_grid

RANGES = ((0.0, 2000.0), (0.0, 900.0), (-200.0, 800.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Z-bed-Y-X-workpiece"), RANGES, 3)
FAMILY = family_from_amplitudes(
    MODEL, {"positioning_um": 8.0, "straightness_um": 5.0, "rotation_urad": 5.0, "squareness_urad": 9.0}
)
TOOL = np.array([0.0, 0.0, -180.0])
BAR = ball_bar("bar", balls=5, length_mm=700.0, tilt_rad=0.3, holder_length_mm=60.0, ball_diameter_mm=25.0)
PLAIN = Options(estimate_scales=False, outliers="none", misfit_mm=0.0)

seeds = st.integers(0, 2**32 - 1)
share = st.floats(0.0, 1.0)


@given(seeds, st.floats(2.0, 60.0), st.integers(4, 25))
def test_any_ball_comes_back_from_its_own_points(seed: int, radius: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-5000.0, 5000.0, 3)
    fixed = np.array([[0, 0, 1], [1, 0, -0.2], [-0.6, 0.8, 0.1], [-0.5, -0.8, 0.3]])
    directions = np.concatenate((fixed, rng.normal(size=(count - 4, 3))))
    points = centre + radius * directions / np.linalg.norm(directions, axis=1)[:, None]
    for known in (None, radius):
        fit = fit_sphere(points, 1e-3, known)
        assert np.abs(fit.centre - centre).max() < 1e-7
        assert abs(fit.radius - radius) < 1e-7


@given(seeds)
def test_a_ball_that_is_moved_and_turned_moves_its_fit_with_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.array([[0, 0, 9], [9, 0, 0], [-9, 0, 0], [0, 9, 0], [0, -9, 0.0]]) + rng.normal(0.0, 0.01, (5, 3))
    turn, shift = Rotation.random(random_state=seed % 1000), rng.uniform(-100.0, 100.0, 3)
    first, second = fit_sphere(points, 1e-3), fit_sphere(turn.apply(points) + shift, 1e-3)
    assert np.abs(turn.apply(first.centre) + shift - second.centre).max() < 1e-8
    turned = turn.as_matrix() @ first.centre_covariance @ turn.as_matrix().T
    assert np.abs(turned - second.centre_covariance).max() < 1e-12


@given(seeds)
def test_a_rigid_pose_is_found_from_its_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=seed % 1000), rng.uniform(-1000.0, 1000.0, 3)
    found = turn.apply(BAR.balls) + shift
    poses = rigid_poses(RowLayout.of(np.zeros(5, dtype=np.int64)), BAR.balls, found)
    assert np.abs(poses.rotation[0] - turn.as_matrix()).max() < 1e-9
    assert np.abs(poses.translation[0] - shift).max() < 1e-6


@cache
def placements() -> Observations:
    rng = np.random.default_rng(5)
    errors = FAMILY.draw(rng, 1)[0]
    turns = Rotation.from_euler("zy", [[0, 0], [90, 0], [45, 30], [-45, -30], [20, 60], [10, 10]], degrees=True)
    rows = []
    for k, turn in enumerate(turns):
        points = turn.apply(BAR.balls - BAR.balls.mean(axis=0)) + np.array([700.0 + 120.0 * k, 450.0, 120.0])
        at = points - TOOL
        for _ in range(4):
            at = points - TOOL - exact_deviation(MODEL, at, TOOL, errors)
        rows += [(k, ball, *place) for ball, place in enumerate(at + rng.normal(0.0, 1e-3, at.shape))]
    table = np.array(rows)
    n = len(table)
    return Observations(
        position=table[:, 0].astype(int),
        ball=table[:, 1].astype(int),
        tool=np.zeros(n, dtype=int),
        axis_positions=table[:, 2:],
        covariance=np.tile(np.eye(3) * 1e-6, (n, 1, 1)),
        temperature_c=np.full(n, 20.0),
        elevation_rad=np.zeros(n),
        tool_offsets=TOOL[None],
    )


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_the_order_of_the_rows_and_the_frame_of_the_artefact_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen, scale = placements(), FAMILY.prior_standard_deviation
    once = identify(MODEL, seen, BAR, FAMILY, PLAIN)
    shuffled = rng.permutation(seen.size)
    turn = Rotation.random(random_state=seed % 1000)
    elsewhere = dataclasses.replace(BAR, balls=turn.apply(BAR.balls) + rng.uniform(-50.0, 50.0, 3))
    again = identify(MODEL, seen.select(shuffled), elsewhere, FAMILY, PLAIN)
    used = scale > 0.0
    assert np.abs((again.parameters - once.parameters)[used] / scale[used]).max() < 1e-4
    assert np.abs(again.residuals_mm - once.residuals_mm[shuffled]).max() < 1e-6


anchors = st.builds(
    lambda place, axes: Anchor(np.array(RANGES)[:, 0] + np.array(place) * np.ptp(RANGES, axis=1), *axes[:2]),
    st.tuples(share, share, share),
    st.permutations(["X", "Y", "Z"]),
)
NODES = regular_nodes(RANGES, (500.0, 450.0, 500.0))
AT_NODES = np.stack(np.meshgrid(*NODES, indexing="ij"), axis=-1).reshape(-1, 3)


@settings(max_examples=40, deadline=None)
@given(seeds, anchors, anchors)
def test_another_anchor_is_another_rigid_motion_of_the_compensated_machine(
    seed: int, first: Anchor, second: Anchor
) -> None:
    """For the largest machines of the family, with both tables active: 1e-9 mm apart from a rigid motion."""
    errors = FAMILY.half_widths * np.random.default_rng(seed).choice([-1.0, 1.0], MODEL.size)
    corrections = [
        build_table(MODEL, errors, NODES, TOOL, anchor, AT_NODES).corrections.reshape(-1, 3)
        for anchor in (first, second)
    ]
    one, other = (c + exact_deviation(MODEL, AT_NODES + c, TOOL, errors) for c in corrections)
    assert np.abs(align_rigidly(AT_NODES + TOOL, one - other)).max() < 1e-9
    assert np.abs(align_rigidly(AT_NODES + TOOL, one)).max() < 1e-9
    # the tables alone: change of the field between the corrected points (twice, to allow for the alignment)
    moved = np.linalg.norm(corrections[0] - corrections[1], axis=1).max()
    left = np.linalg.norm(align_rigidly(AT_NODES + TOOL, corrections[0] - corrections[1]), axis=1).max()
    assert left <= 2.0 * steepest(errors) * moved + 1e-9


def steepest(errors: np.ndarray) -> float:
    """Return the largest slope of the deviation field, from differences over 1 mm on a fine grid."""
    fine = evaluation_grid(RANGES, (41, 19, 21))
    here = exact_deviation(MODEL, fine, TOOL, errors)
    slopes = [exact_deviation(MODEL, fine + step, TOOL, errors) - here for step in np.eye(3)]
    return float(np.sqrt(sum(np.square(slope).sum(axis=1) for slope in slopes)).max())
