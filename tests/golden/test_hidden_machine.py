"""A machine that the model cannot represent: does what is stated of it hold?

The truth has Legendre orders up to 7, a deflection field, an artefact that is off within its certificate, touch noise
and two gross errors; the model has order 5 and the certificate. Figures are over all seeds.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from twin.artefact import ball_bar
from twin.chain import parse_chain
from twin.deflection import CASE_STUDY_NODES, cantilever_deflection
from twin.error_model import ErrorModel
from twin.family import Family, family_from_amplitudes
from twin.identification import Estimate, field_uncertainty, identify, predicted_vce
from twin.machine_model import exact_deviation
from twin.observations import Observations
from twin.position_set import MountGeometry, mount_pose, positions_of, reachable, station_places
from twin.table import Anchor, build_table, regular_nodes
from twin.volumetric import evaluation_grid, volumetric_error

RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
TOOL = np.array([0.0, 250.0, 0.0])
AMPLITUDES = {
    "positioning_um": [8.0, 5.0, 3.0, 1.8, 1.1],
    "straightness_um": [5.5, 3.3, 2.0, 1.2],
    "rotation_urad": [4.6, 2.8, 1.7, 1.0, 0.6],
    "squareness_urad": 9.0,
    "cross_displacement_um": 4.5,
    "cross_rotation_urad": 3.0,
}
CERTIFICATE_MM = 0.8e-3
NOISE_MM = 1e-3
SEEDS = range(6)
GROSS = {20: np.array([0.02, 0.0, 0.01]), 100: np.array([0.0, -0.05, 0.0])}
DEFLECTION = cantilever_deflection(*CASE_STUDY_NODES)


def family_of_order(order: int) -> Family:
    model = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, order)
    return family_from_amplitudes(model, AMPLITUDES)


@dataclass(frozen=True)
class Night:
    truth: np.ndarray
    parameters: np.ndarray
    seen: Observations
    estimate: Estimate


HIDDEN, OWN = family_of_order(7), family_of_order(5)
GRID = evaluation_grid(RANGES, (20, 10, 10))


def truth_at(points: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    inside = np.clip(points, *np.array(RANGES).T)
    return exact_deviation(HIDDEN.model, points, TOOL, parameters) + DEFLECTION.at(inside)


@cache
def night(seed: int) -> Night:
    rng = np.random.default_rng(seed)
    parameters = HIDDEN.draw(rng, 1)[0]
    certified = ball_bar(
        "bar",
        balls=11,
        length_mm=1500.0,
        tilt_rad=math.radians(15.0),
        holder_length_mm=60.0,
        ball_diameter_mm=25.0,
        standard_uncertainty_mm=CERTIFICATE_MM,
    )
    slip = rng.normal(0.0, CERTIFICATE_MM, certified.balls.shape)
    real = dataclasses.replace(certified, balls=certified.balls + slip)
    places = station_places(4, RANGES[0], 560.0, 900.0, 750.0)
    lower, upper = np.array(RANGES).T
    rows = []
    for number, position in enumerate(positions_of("S3", 4)):
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        points = (
            mount_pose(places[position.station - 1], MountGeometry(), azimuth, elevation).applied(real.balls) - TOOL
        )
        for ball in np.flatnonzero(reachable(points, lower, upper, np.full(3, 10.0))):
            rows.append((number, ball, elevation, *points[ball]))
    table = np.array(rows)
    found = table[:, 3:]
    for _ in range(4):
        found = table[:, 3:] - truth_at(found, parameters)
    found = found + rng.normal(0.0, NOISE_MM, found.shape)
    for row, slip_mm in GROSS.items():
        found[row] += slip_mm
    n = len(table)
    seen = Observations(
        position=table[:, 0].astype(int),
        ball=table[:, 1].astype(int),
        tool=np.zeros(n, dtype=int),
        axis_positions=found,
        covariance=np.tile(np.eye(3) * NOISE_MM**2, (n, 1, 1)),
        temperature_c=np.full(n, 20.0),
        elevation_rad=table[:, 2],
        tool_offsets=TOOL[None],
    )
    estimate = identify(OWN.model, seen, certified, OWN)
    return Night(truth_at(GRID, parameters), parameters, seen, estimate)


def left(one: Night) -> np.ndarray:
    return one.truth - exact_deviation(OWN.model, GRID, TOOL, one.estimate.parameters)


def test_exactly_the_gross_errors_are_rejected() -> None:
    for seed in SEEDS:
        one = night(seed)
        expected = {(int(one.seen.position[row]), int(one.seen.ball[row]), 0) for row in GROSS}
        assert set(one.estimate.rejected) == expected


def test_the_aligned_volumetric_error_falls_to_about_a_third() -> None:
    before = [volumetric_error(GRID + TOOL, night(seed).truth).aligned_um for seed in SEEDS]
    after = [volumetric_error(GRID + TOOL, left(night(seed))).aligned_um for seed in SEEDS]
    assert 7.0 < np.mean(before) < 13.0
    assert np.mean(after) < 0.42 * np.mean(before)
    assert max(after) < 5.5


def test_the_predicted_error_is_near_the_true_one() -> None:
    ratios = []
    for seed in SEEDS:
        true = volumetric_error(GRID + TOOL, left(night(seed))).aligned_mm
        ratios.append(predicted_vce(night(seed).estimate, GRID, TOOL).aligned_mm / true)
    assert min(ratios) > 0.6
    assert max(ratios) < 1.6
    assert 0.85 < np.mean(ratios) < 1.35


def test_the_field_lies_inside_its_stated_uncertainty() -> None:
    """At random points, after the one rigid motion that no artefact sees: squares near 1, few beyond two sigma."""
    points = np.random.default_rng(77).uniform(*np.array(RANGES).T, (1500, 3))
    squares, beyond = [], []
    for seed in SEEDS:
        one = night(seed)
        field = truth_at(points, one.parameters)
        field = field - exact_deviation(OWN.model, points, TOOL, one.estimate.parameters)
        sigma = field_uncertainty(one.estimate, points, TOOL, aligned=True)
        ratio = aligned(points + TOOL, field) / sigma
        squares.append(np.mean(ratio**2))
        beyond.append(np.mean(np.abs(ratio) > 2.0))
    assert 0.4 < np.mean(squares) < 1.3
    assert np.mean(beyond) < 0.08


def aligned(points: np.ndarray, field: np.ndarray) -> np.ndarray:
    """What is left after the best small rigid motion, by plain least squares."""
    arms = (points - points.mean(axis=0)) / 1000.0
    motions = np.zeros((len(points), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        motions[:, :, 3 + k] = np.cross(axis, arms)
    flat = motions.reshape(-1, 6)
    return field - (flat @ np.linalg.lstsq(flat, field.reshape(-1), rcond=None)[0]).reshape(-1, 3)


def test_residuals_agree_with_the_stated_noise() -> None:
    for seed in SEEDS:
        assert 0.8 < night(seed).estimate.chi2_normalised < 1.35


def test_the_table_does_to_the_machine_what_was_predicted() -> None:
    """Added to the commanded position, with trilinear reading, on the machine as it really is."""
    one = night(SEEDS[0])
    nodes = regular_nodes(RANGES, (100.0, 100.0, 100.0))
    table = build_table(OWN.model, one.estimate.parameters, nodes, TOOL, Anchor(np.zeros(3)), one.seen.axis_positions)
    correction = table.at(GRID)
    compensated = correction + truth_at(GRID + correction, one.parameters)
    after = volumetric_error(GRID + TOOL, compensated).aligned_um
    assert after < 0.55 * volumetric_error(GRID + TOOL, one.truth).aligned_um
    assert abs(after - volumetric_error(GRID + TOOL, left(one)).aligned_um) < 0.15
