"""Paths of a run: free by dense sampling of all bodies, no slower than needed, and the same at every station."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.artefact_bodies import ArtefactPose
from agent.probing.paths.free_paths import (
    UNCERTAINTY_STEPS_MM,
    FreePathFinder,
    FreePathRules,
    round_up_uncertainty,
)
from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position
from twin.collision.accessibility import measuring_scene
from twin.collision.collision import Scene
from twin.collision.free_paths import AxisDynamics, FreePath
from twin.collision.geometry import point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry

BAR = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip
ALONG_Y = ProbeFrame(1, 1)
PROBE, MOUNT = ProbeGeometry(), MountGeometry()
CONTACT_MM = 12.5 + PROBE.tip_radius_mm
LOWER, UPPER, TOOL = np.zeros(3), np.array([4000.0, 1300.0, 1500.0]), np.array([0.0, 250.0, 0.0])
PLACES = {1: np.array([1200.0, 1000.0, 750.0]), 2: np.array([2700.0, 1000.0, 750.0])}
DYNAMICS = AxisDynamics((333.0, 333.0, 250.0), (500.0, 400.0, 500.0), 0.01)
CLEARANCE_MM, KNOWN_MM, UNKNOWN_MM = 2.0, 0.5, 4.0
ORIENTATIONS = [(45.0, 0.0), (-30.0, -30.0), (90.0, 45.0)]


def path_finder(frame: ProbeFrame = ALONG_Y, dynamics: AxisDynamics = DYNAMICS) -> FreePathFinder:
    """Return a finder for the machine of this file, rotated as a whole so that its stylus points along `frame`."""
    ends = np.sort(np.stack([frame.to_workpiece(LOWER), frame.to_workpiece(UPPER)]), axis=0)
    places = {station: frame.to_workpiece(place) for station, place in PLACES.items()}
    layout = MeasuringLayout(BAR, MOUNT, PROBE, places, frame.to_workpiece(TOOL), ends[0], ends[1], CONTACT_MM, 5.0)
    finder = FreePathRules(ends[0], ends[1], dynamics, CLEARANCE_MM, KNOWN_MM, UNKNOWN_MM)
    return finder.finder_for(layout)


def before_the_ball(ball: int, out_mm: float = CONTACT_MM + 20.0, frame: ProbeFrame = ALONG_Y) -> TipLocation:
    return TipLocation(ball, point(frame.stylus_axis), out_mm)


def standing_bodies(station: int, azimuth: float, elevation: float) -> Scene:
    _, scene = measuring_scene(
        BAR,
        PROBE,
        MOUNT,
        frame=ALONG_Y,
        location_mm=PLACES[station],
        azimuth_rad=math.radians(azimuth),
        elevation_rad=math.radians(elevation),
    )
    return scene


def sampled_gap(scene: Scene, stops: list[np.ndarray]) -> float:
    """Return the smallest gap of any two bodies on the path through tip centres `stops`, every 2 mm, up to 30 mm."""
    gaps = []
    for first, last in pairwise(stops):
        count = max(2, math.ceil(float(np.linalg.norm(last - first)) / 2.0))
        gaps += [scene.clearance(point(first + s * (last - first)), at_most=30.0) for s in np.linspace(0.0, 1.0, count)]
    return min(gaps)


def test_balls_are_where_the_layout_says() -> None:
    finder = path_finder()
    pose = finder.pose_at(2, 45.0, 30.0)
    assert pose == ArtefactPose(45.0, 30.0, (0.0, 1000.0, 750.0))
    expected = finder.layout.nominal(Position(2, 45.0, 30.0))
    assert finder.ball_axes(pose, 2) == pytest.approx(expected, abs=1e-9)
    centre = expected[3] + TOOL
    tip = np.array(finder.tip_at(pose, before_the_ball(3, 40.0))) + PLACES[2]
    assert tip == pytest.approx(centre - (0.0, 40.0, 0.0), abs=1e-9)
    assert finder.axes_at(2, point(tip - PLACES[2])) == pytest.approx(tip - TOOL, abs=1e-9)


@pytest.mark.parametrize(("azimuth", "elevation"), ORIENTATIONS)
@pytest.mark.parametrize(("first", "last"), [(0, 10), (2, 3), (9, 4)])
def test_a_path_between_balls_is_free_and_inside_the_travel(
    azimuth: float, elevation: float, first: int, last: int
) -> None:
    finder = path_finder()
    pose = finder.pose_at(1, azimuth, elevation)
    start, end = before_the_ball(first), before_the_ball(last)
    path = finder.path_between(pose, start, end, KNOWN_MM, 1)
    assert path is not None
    stops = [
        np.array(stop) + PLACES[1] for stop in (finder.tip_at(pose, start), *path.corners, finder.tip_at(pose, end))
    ]
    bodies = standing_bodies(1, azimuth, elevation)
    assert sampled_gap(bodies, stops) >= CLEARANCE_MM - 0.1
    if (first, last) == (0, 10) and azimuth > 0.0:
        assert sampled_gap(bodies, [stops[0], stops[-1]]) < 0.0  # the straight line would hit something
    axes = np.array(stops[1:-1]).reshape(-1, 3) - TOOL
    assert ((axes >= LOWER) & (axes <= UPPER)).all()
    assert path.seconds == pytest.approx(float(DYNAMICS.seconds(np.array([stops]))[0]))
    assert path.seconds >= float(finder.straight_seconds(pose, [start], [end])[0, 0]) - 1e-9


def test_a_path_is_sought_once_and_serves_every_station() -> None:
    finder = path_finder()
    start, end = before_the_ball(2), before_the_ball(7)
    one, other = (
        finder.path_between(finder.pose_at(station, 45.0, 0.0), start, end, KNOWN_MM, station) for station in PLACES
    )
    assert one is not None
    assert one is other


def test_runs_with_the_same_layout_and_rules_share_their_paths_and_others_do_not() -> None:
    layout = path_finder().layout
    start, end = before_the_ball(2), before_the_ball(7)

    def found(clearance_mm: float) -> FreePath | None:
        finder = FreePathRules(LOWER, UPPER, DYNAMICS, clearance_mm, KNOWN_MM, UNKNOWN_MM).finder_for(layout)
        return finder.path_between(finder.pose_at(1, 45.0, 0.0), start, end, KNOWN_MM, 1)

    assert found(CLEARANCE_MM) is not None
    assert found(CLEARANCE_MM) is found(CLEARANCE_MM)
    assert found(40.0) != found(CLEARANCE_MM)


def test_a_path_keeps_more_room_if_the_artefact_may_be_further_off() -> None:
    finder = path_finder()
    pose = finder.pose_at(1, 45.0, 0.0)
    start, end = before_the_ball(0, CONTACT_MM + 30.0), before_the_ball(5, CONTACT_MM + 30.0)
    path = finder.path_between(pose, start, end, 8.0, 1)
    assert path is not None
    stops = [
        np.array(stop) + PLACES[1] for stop in (finder.tip_at(pose, start), *path.corners, finder.tip_at(pose, end))
    ]
    assert sampled_gap(standing_bodies(1, 45.0, 0.0), stops) >= CLEARANCE_MM + 8.0 - 0.1


def test_the_tip_waits_clear_of_the_artefact_while_it_turns() -> None:
    finder = path_finder()
    before, after = finder.pose_at(1, 0.0, 0.0), finder.pose_at(1, 30.0, 20.0)
    start, end = before_the_ball(0), before_the_ball(10)
    path = finder.turning_path(before, start, after, end, 1)
    assert path is not None
    waiting = np.array(path.waiting_point) + PLACES[1]
    for share in np.linspace(0.0, 1.0, 13):
        for other in (share, 0.0, 1.0):  # both axes of the mount turn, but not in step
            scene = standing_bodies(1, 30.0 * share, 20.0 * other)
            assert scene.clearance(point(waiting), at_most=30.0) >= CLEARANCE_MM + UNKNOWN_MM - 0.1
    least = finder.min_turning_seconds(before, [start], after, [end])
    assert least <= path.seconds + 1e-9
    assert finder.turning_path(before, start, after, end, 1, faster_than_s=path.seconds) is None


@pytest.mark.parametrize("frame", [ProbeFrame(1, -1), ProbeFrame(0, 1), ProbeFrame(0, -1)])
def test_a_machine_rotated_about_z_has_the_rotated_paths(frame: ProbeFrame) -> None:
    alike = AxisDynamics((300.0, 300.0, 250.0), (500.0, 500.0, 400.0), 0.01)
    finders = {one: path_finder(one, alike) for one in (ALONG_Y, frame)}
    paths = [
        finder.path_between(
            finder.pose_at(1, 45.0 + one.facing_deg, 0.0),
            before_the_ball(0, frame=one),
            before_the_ball(10, frame=one),
            KNOWN_MM,
            1,
        )
        for one, finder in finders.items()
    ]
    assert paths[0] is not None
    assert paths[1] is not None
    assert frame.to_frame(np.array(paths[1].corners)) == pytest.approx(np.array(paths[0].corners), abs=1e-6)
    assert paths[1].seconds == pytest.approx(paths[0].seconds)
    turns = [
        finder.turning_path(
            finder.pose_at(1, one.facing_deg, 0.0),
            before_the_ball(0, frame=one),
            finder.pose_at(1, one.facing_deg + 30.0, 20.0),
            before_the_ball(10, frame=one),
            1,
        )
        for one, finder in finders.items()
    ]
    assert turns[0] is not None
    assert turns[1] is not None
    assert turns[1].seconds == pytest.approx(turns[0].seconds, rel=0.05)  # the grid of waiting points is not rotated


@pytest.mark.parametrize(("off_by", "allowed"), [(0.0, 0.5), (0.5, 0.5), (0.51, 1.0), (9.0, 16.0), (33.0, 33.0)])
def test_an_uncertainty_is_rounded_up_to_the_next_step(off_by: float, allowed: float) -> None:
    assert round_up_uncertainty(off_by) == allowed
    assert round_up_uncertainty(off_by) in (*UNCERTAINTY_STEPS_MM, off_by)
