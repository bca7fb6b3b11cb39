"""Swept set of a rotating artefact compared with the bodies themselves at random intermediate angles."""

import math

import numpy as np
import pytest

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import mount_pose
from twin.collision.accessibility import measuring_scene
from twin.collision.bodies import mount_bodies, table_body
from twin.collision.geometry import Shape, point
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry
from twin.collision.swept_volume import TurnSweep, _least_around, cover_turning_bodies, turn_sweep

BAR = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip
PROBE, MOUNT = ProbeGeometry(), MountGeometry()
ALONG_Y = ProbeFrame(1, 1)
PLACE = np.array([0.0, 1000.0, 750.0])
CLEARANCE_MM = 9.0
TURNS = [
    ((45.0, 0.0), (-45.0, 0.0)),
    ((0.0, -45.0), (90.0, 45.0)),
    ((90.0, 45.0), (90.0, -45.0)),
    ((30.0, 30.0), (30.0, 30.0)),
    ((-120.0, 60.0), (170.0, -80.0)),
]


def still() -> list[Shape]:
    pose = mount_pose(PLACE, MOUNT, 0.0, 0.0)
    bodies = (*mount_bodies(MOUNT, PLACE, pose), table_body(MOUNT, PLACE, ALONG_Y))
    return [body.shape.translated(point(-PLACE)) for body in bodies if body.name != "shaft"]


def sweep_of(turn: tuple[tuple[float, float], tuple[float, float]]) -> TurnSweep:
    return turn_sweep(cover_turning_bodies(BAR, MOUNT), PROBE, ALONG_Y, still(), *turn, clearance_mm=CLEARANCE_MM)


@pytest.mark.parametrize("turn", TURNS)
def test_the_probe_keeps_its_clearance_whatever_angles_the_mount_goes_through(turn) -> None:
    sweep, rng = sweep_of(turn), np.random.default_rng(3)
    x, z = rng.uniform(-950.0, 950.0, (2, 60))
    y = np.minimum(sweep.at(x, z), 300.0)
    low, high = np.sort(np.array(turn), axis=0)
    for _ in range(50):
        azimuth, elevation = rng.uniform(low, high)
        _, scene = measuring_scene(
            BAR,
            PROBE,
            MOUNT,
            frame=ALONG_Y,
            location_mm=PLACE,
            azimuth_rad=math.radians(azimuth),
            elevation_rad=math.radians(elevation),
        )
        for place in np.column_stack([x, y, z]):
            assert scene.clearance(point(PLACE + place), at_most=CLEARANCE_MM + 1.0) >= CLEARANCE_MM


@pytest.mark.parametrize("turn", TURNS[:2])
def test_it_is_not_much_larger_than_what_is_swept(turn) -> None:
    """Check in front of the middle of the bar, where the sweep is broad, that the bound is within 270 mm of
    the bodies.
    """
    sweep = sweep_of(turn)
    low, high = np.sort(np.array(turn), axis=0)
    angles = [(a, e) for a in np.linspace(low[0], high[0], 19) for e in np.linspace(low[1], high[1], 19)]
    for x, z in [(0.0, 0.0), (150.0, 0.0), (-150.0, 0.0)]:
        nearest = math.inf
        for azimuth, elevation in angles:
            _, scene = measuring_scene(
                BAR, PROBE, MOUNT, frame=ALONG_Y, location_mm=PLACE, azimuth_rad=math.radians(azimuth),
                elevation_rad=math.radians(elevation),
            )  # fmt: skip
            far = np.array([x, -990.0, z])
            hit = scene.first_hit(point(PLACE + far), point(PLACE + far + (0.0, 1800.0, 0.0)))
            nearest = min(nearest, -990.0 + 1800.0 * hit.fraction if hit else math.inf)
        assert nearest - 270.0 - CLEARANCE_MM <= float(sweep.at(np.array(x), np.array(z))) <= nearest


def test_where_nothing_comes_by_the_probe_may_stand_as_deep_as_it_likes() -> None:
    sweep = sweep_of(((90.0, 45.0), (90.0, -45.0)))
    assert np.isinf(sweep.at(np.array([600.0, -400.0]), np.array([100.0, 500.0]))).all()


def test_everything_that_turns_lies_in_its_cover() -> None:
    cover = cover_turning_bodies(BAR, MOUNT)
    balls = BAR.balls - (0.0, MOUNT.shaft_mm, 0.0)
    gaps = np.linalg.norm(balls[:, None] - cover.centres[None], axis=2) + BAR.ball_radius_mm - cover.radii
    assert gaps.min(axis=1).max() <= 1e-9


@pytest.mark.parametrize("reach", [1, 2, 3, 7, 12])
def test_the_least_around_is_that_of_each_window(reach: int) -> None:
    values = np.random.default_rng(2).uniform(size=(9, 4))
    windows = [values[max(row - reach, 0) : row + reach + 1].min(axis=0) for row in range(9)]
    assert np.array_equal(_least_around(values, reach), windows)
