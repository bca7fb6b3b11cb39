import math

import numpy as np
import pytest

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.touch_pattern import approach_directions
from twin.collision.accessibility import accessible_balls, measuring_scene
from twin.collision.bodies import Body
from twin.collision.collision import Scene
from twin.collision.geometry import Box, sphere
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry
from twin.errors import DataError

ALONG_Y = ProbeFrame(1, 1)
FIVE_TOUCHES = approach_directions(5, ALONG_Y.stylus_axis)
PLACE = np.array([2000.0, 1000.0, 750.0])
BAR = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip


def scene_at(azimuth_deg: float, elevation_deg: float) -> tuple[np.ndarray, Scene]:
    return measuring_scene(
        BAR, ProbeGeometry(), MountGeometry(), frame=ALONG_Y, location_mm=PLACE,
        azimuth_rad=math.radians(azimuth_deg), elevation_rad=math.radians(elevation_deg),
    )  # fmt: skip


def test_the_first_of_two_obstacles_is_named_with_its_fraction() -> None:
    ball = Body("ball 0", sphere((0.0, 100.0, 0.0), 10.0))
    wall = Body("wall", Box((-50.0, 200.0, -50.0), (50.0, 210.0, 50.0)))
    scene = Scene(ProbeGeometry(tip_radius_mm=3.0).bodies(ALONG_Y), [wall, ball])
    hit = scene.first_hit((0.0, 0.0, 0.0), (0.0, 400.0, 0.0))
    assert hit is not None
    assert (hit.moving, hit.obstacle) == ("tip", "ball 0")
    assert hit.fraction == pytest.approx((100.0 - 13.0) / 400.0, abs=1e-6)
    later = scene.first_hit((0.0, 0.0, 0.0), (0.0, 400.0, 0.0), ignored={("tip", "ball 0"), ("stem", "ball 0")})
    assert later is not None
    assert (later.moving, later.obstacle) == ("probe body", "ball 0") or later.obstacle == "wall"


def test_moving_sideways_at_the_depth_of_the_body_hits_with_the_body() -> None:
    ball = Body("ball 0", sphere((100.0, -150.0, 0.0), 10.0))
    hit = Scene(ProbeGeometry().bodies(ALONG_Y), [ball]).first_hit((0.0, 0.0, 0.0), (200.0, 0.0, 0.0))
    assert hit is not None
    assert (hit.moving, hit.obstacle) == ("probe body", "ball 0")
    assert hit.fraction * 200.0 == pytest.approx(100.0 - 35.0, abs=1e-5)


def test_clearance_is_the_smallest_gap() -> None:
    ball = Body("ball 0", sphere((0.0, 50.0, 0.0), 10.0))
    scene = Scene(ProbeGeometry(tip_radius_mm=3.0).bodies(ALONG_Y), [ball])
    assert scene.clearance((0.0, 0.0, 0.0)) == pytest.approx(37.0)
    assert scene.clearance((0.0, 0.0, 0.0), at_most=5.0) == 5.0
    assert scene.clearance((0.0, 45.0, 0.0)) == pytest.approx(-8.0)


@pytest.mark.parametrize(
    "angles", [(45, 0), (-45, 0), (0, 45), (0, -45), (90, 45), (90, -45), (45, 35.264), (-45, -35.264)]
)
def test_a_straight_probe_gets_at_every_ball_of_s3_and_s2(angles: tuple[float, float]) -> None:
    centres, scene = scene_at(*angles)
    assert accessible_balls(centres, scene, contact_mm=15.5, approach_mm=8.0, directions=FIVE_TOUCHES).all()


def test_a_bar_along_the_stylus_hides_every_ball_but_the_first() -> None:
    centres, scene = scene_at(90, 0)
    assert (
        accessible_balls(centres, scene, contact_mm=15.5, approach_mm=5.0, directions=FIVE_TOUCHES).tolist()
        == [True] + [False] * 10
    )


def test_a_probe_too_short_for_its_body_is_refused() -> None:
    with pytest.raises(DataError, match="too short"):
        ProbeGeometry(stem_length_mm=230.0)
