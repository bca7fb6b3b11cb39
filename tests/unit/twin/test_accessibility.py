"""Balls that a pattern can touch: compared with a brute-force walk of the tip, and for the patterns on the
named sets.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import parse_position_set
from twin.artefact.touch_pattern import QUALIFYING_RINGS, RINGS, approach_directions, ring_directions
from twin.collision.accessibility import accessible_balls, measuring_scene
from twin.collision.bodies import TIP, Body, ball_name
from twin.collision.collision import Scene
from twin.collision.geometry import Capsule, point, sphere
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry

ALONG_Y = ProbeFrame(1, 1)
PLACE = np.array([2000.0, 1000.0, 750.0])
BAR = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip
CONTACT_MM, APPROACH_MM = 15.5, 8.0
ORIENTATIONS = sorted({(p.azimuth_deg, p.elevation_deg) for name in ("S2", "S3") for p in parse_position_set(name, 1)})


def scene_at(azimuth_deg: float, elevation_deg: float) -> tuple[np.ndarray, Scene]:
    return measuring_scene(
        BAR, ProbeGeometry(), MountGeometry(), frame=ALONG_Y, location_mm=PLACE,
        azimuth_rad=math.radians(azimuth_deg), elevation_rad=math.radians(elevation_deg),
    )  # fmt: skip


def touched(azimuth_deg: float, elevation_deg: float, directions: np.ndarray) -> np.ndarray:
    centres, scene = scene_at(azimuth_deg, elevation_deg)
    return accessible_balls(centres, scene, contact_mm=CONTACT_MM, approach_mm=APPROACH_MM, directions=directions)


@pytest.mark.parametrize("count", RINGS)
def test_every_pattern_gets_at_every_ball_of_s2_and_s3_so_that_none_needs_to_be_turned(count: int) -> None:
    directions = approach_directions(count, ALONG_Y.stylus_axis)
    for azimuth, elevation in ORIENTATIONS:
        assert touched(azimuth, elevation, directions).all(), (azimuth, elevation)


def test_rings_of_eight_on_the_equator_run_into_holders_that_lean_with_the_stylus() -> None:
    dense = ring_directions(QUALIFYING_RINGS, ALONG_Y.stylus_axis)
    assert touched(45, 0, dense).all()
    assert not touched(90, 45, dense).any()


@pytest.mark.parametrize(
    ("azimuth", "elevation", "count"), [(120, 60, 5), (-150, 60, 5), (135, -45, 9), (90, -45, 13), (60, 30, 25)]
)
def test_access_is_what_a_walk_in_small_steps_finds(azimuth: float, elevation: float, count: int) -> None:
    """Place the tip at every half millimetre of the path of every touch and check that nothing comes near."""
    directions = approach_directions(count, ALONG_Y.stylus_axis)
    centres, scene = scene_at(azimuth, elevation)
    mask = touched(azimuth, elevation, directions)
    for index in range(0, 11, 2):
        room = walked_room_mm(scene, centres[index], index, directions)
        assert room >= 0.4 if mask[index] else room < 1.0, index


def walked_room_mm(scene: Scene, centre: np.ndarray, index: int, directions: np.ndarray) -> float:
    """Return the smallest distance of any body but tip and stem from the target ball, and of those two from
    all others.
    """
    meant = {(TIP, ball_name(index)), ("stem", ball_name(index))}
    out, least = CONTACT_MM + APPROACH_MM, 5.0
    before = None
    for direction in directions:
        start = centre - direction * out
        above = np.array([start[0], centre[1] - out, start[2]])
        legs = [(above, start), (start, centre - direction * CONTACT_MM)]
        legs += [] if before is None else [(before, above)]
        for a, b in legs:
            for part in np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(b - a) / 0.5))):
                least = min(least, scene.clearance(point(a + part * (b - a)), ignored=meant, at_most=5.0))
        before = above
    return least


@pytest.mark.parametrize("lean_deg", [30.0, 36.0, 39.7, 45.0, 60.0])
@pytest.mark.parametrize("overtravel_mm", [0.0, 0.4, 0.97])
def test_the_tip_keeps_off_the_holder_until_it_rests(lean_deg: float, overtravel_mm: float) -> None:
    """Move a tip of 3.5 mm to a ball of 5.5 mm from +X; the holder of 1.6 mm leans by the given angle from +X.

    At rest the distance of the tip centre from the holder axis is that from the ball centre times the sine.
    """
    lean = math.radians(lean_deg)
    ball, holder = (
        sphere((0.0, 0.0, 0.0), 5.5),
        Capsule((0.0,) * 3, (80.0 * math.cos(lean), 0.0, 80.0 * math.sin(lean)), 1.6),
    )
    scene = Scene([Body(TIP, sphere((0.0, 0.0, 0.0), 3.5))], [Body(ball_name(0), ball), Body("post 0", holder)])
    directions = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    (free,) = accessible_balls(
        np.zeros((1, 3)), scene, contact_mm=9.0, approach_mm=5.0, directions=directions, overtravel_mm=overtravel_mm
    )
    assert free == ((9.0 - overtravel_mm) * math.sin(lean) - 3.5 - 1.6 >= 0.5)
