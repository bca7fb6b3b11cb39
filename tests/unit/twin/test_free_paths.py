"""Paths: their duration by the scalar law, and proved clearance compared with dense sampling of all bodies."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.collision.accessibility import measuring_scene
from twin.collision.bodies import Body
from twin.collision.collision import Scene
from twin.collision.free_paths import (
    AxisDynamics,
    Clearances,
    FreePath,
    PathCandidates,
    PrefilteredScene,
    direct_path,
    fastest_path,
    retract_candidates,
)
from twin.collision.geometry import Box, Point, point, separation, sphere
from twin.collision.motion_law import straight_path, travel_time_s, travel_times
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry

BAR = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip
ALONG_Y = ProbeFrame(1, 1)
DYNAMICS = AxisDynamics((333.0, 333.0, 250.0), (500.0, 400.0, 500.0), 0.01)
BACK = np.array([0.0, -1.0, 0.0])
coordinate = st.floats(-900.0, 900.0)
points = st.tuples(coordinate, coordinate, coordinate)


@given(points, points)
@settings(max_examples=200, deadline=None)
def test_many_times_at_once_are_those_of_the_law(start: Point, end: Point) -> None:
    path = straight_path(start, end)
    speed, acceleration = path.limit_along(DYNAMICS.rapid_mm_per_s), path.limit_along(DYNAMICS.acceleration_mm_per_s2)
    expected = travel_time_s(path.length, speed, acceleration)
    found = travel_times(np.array(start), np.array(end), DYNAMICS.rapid_mm_per_s, DYNAMICS.acceleration_mm_per_s2)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_seconds_of_a_way_are_those_of_its_moves() -> None:
    # 50 mm along Y with 400 mm/s²: 2·√(50/400) s; 450 mm along X: ramps of 0.666 s to 333 mm/s, then 228.222 mm.
    corners = np.array([[(0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (450.0, 50.0, 0.0)]])
    cruise = (450.0 - 333.0**2 / 500.0) / 333.0
    assert DYNAMICS.seconds(corners) == pytest.approx(2.0 * math.sqrt(0.125) + 2.0 * 0.666 + cruise + 0.02)


def best(scene: Scene, start: Point, end: Point, corners: list[np.ndarray], apart: Clearances) -> FreePath | None:
    """Return the straight path or one through `corners`."""
    candidates = PathCandidates.of(corners)
    return direct_path(scene, DYNAMICS, start, end, apart) or fastest_path(
        PrefilteredScene.of(scene), DYNAMICS, start, end, candidates, apart
    )


def sampled_gap(scene: Scene, stops: list[Point]) -> float:
    """Return the smallest gap of any two bodies on the path, every 0.5 mm."""
    smallest = math.inf
    for a, b in pairwise(stops):
        count = max(2, math.ceil(math.dist(a, b) / 0.5))
        for share in np.linspace(0.0, 1.0, count):
            tip = point(np.array(a) + share * (np.array(b) - np.array(a)))
            smallest = min(smallest, scene.clearance(tip, at_most=30.0))
    return smallest


@pytest.mark.parametrize(("azimuth", "elevation"), [(45.0, 0.0), (-30.0, -30.0), (0.0, 90.0), (90.0, 45.0)])
def test_a_way_keeps_its_clearance_from_everything_all_along(azimuth: float, elevation: float) -> None:
    centres, scene = measuring_scene(
        BAR, ProbeGeometry(), MountGeometry(), frame=ALONG_Y, location_mm=np.array([700.0, 1000.0, 750.0]),
        azimuth_rad=math.radians(azimuth), elevation_rad=math.radians(elevation),
    )  # fmt: skip
    rng = np.random.default_rng(5)
    for _ in range(6):
        first, last = rng.choice(11, 2, replace=False)
        ends = [point(centres[ball] - (0.0, 30.0, 0.0)) for ball in (first, last)]
        way = best(scene, ends[0], ends[1], retract_candidates(ends[0], ends[1], BACK, -1000.0), Clearances(2.0))
        assert way is not None
        stops = [ends[0], *way.corners, ends[1]]
        assert sampled_gap(scene, stops) >= min(2.0, *(scene.clearance(end) for end in ends)) - 0.05


def test_the_fastest_that_is_free_is_taken_and_a_faster_one_would_hit() -> None:
    wall = Body("wall", Box((40.0, -20.0, -500.0), (60.0, 400.0, 500.0)))
    scene = Scene(ProbeGeometry().bodies(ALONG_Y), [wall])
    start, end = (0.0, 0.0, 0.0), (100.0, 0.0, 0.0)
    corners = retract_candidates(start, end, BACK, -1000.0)
    way = best(scene, start, end, corners, Clearances(1.0))
    assert way is not None
    assert min(y for _, y, _ in way.corners) < -24.0
    for group in (np.empty((1, 0, 3)), *corners):
        for candidate, seconds in zip(group, DYNAMICS.seconds(whole(start, group, end)), strict=True):
            if seconds < way.seconds - 1e-9:
                assert sampled_gap(scene, [start, *(point(corner) for corner in candidate), end]) < 1.0 + 0.01


def whole(start: Point, group: np.ndarray, end: Point) -> np.ndarray:
    return np.array([[start, *candidate.tolist(), end] for candidate in group], dtype=float).reshape(len(group), -1, 3)


def test_no_way_where_everything_is_closed() -> None:
    wall = Body("wall", Box((40.0, -3000.0, -500.0), (60.0, 400.0, 500.0)))
    scene = Scene(ProbeGeometry().bodies(ALONG_Y), [wall])
    start, end = (0.0, 0.0, 0.0), (100.0, 0.0, 0.0)
    assert best(scene, start, end, retract_candidates(start, end, BACK, -900.0), Clearances(1.0)) is None


def test_a_way_leaves_what_it_stands_too_near_to_but_does_not_come_nearer() -> None:
    near = Body("ball 0", sphere((0.0, 0.0, 8.0), 4.5))
    scene = Scene(ProbeGeometry(tip_radius_mm=3.0).bodies(ALONG_Y), [near])
    here, away, past = (0.0, 0.0, 0.0), (0.0, 0.0, -50.0), (0.0, 0.0, 60.0)
    assert separation(scene.moving[0].shape, near.shape)[0] == pytest.approx(0.5)
    assert scene.is_free(here, away, 2.0)
    assert not scene.is_free(here, past, 2.0)
    assert not scene.is_free(away, here, 2.0)
    assert scene.is_free(away, here, 2.0, {("tip", "ball 0"): 0.3, ("stem", "ball 0"): 0.3})
