"""The six directions of a stylus: everything that is computed for a rotated machine is the rotated result."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, mount_pose, parse_position_set
from twin.artefact.touch_pattern import approach_directions
from twin.collision.accessibility import accessible_balls, measuring_scene
from twin.collision.bodies import TABLE, Body, mount_bodies, table_body
from twin.collision.collision import Scene
from twin.collision.geometry import Box, Capsule, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry
from twin.collision.swept_volume import cover_turning_bodies, turn_sweep
from twin.errors import DataError

FRAMES = [ProbeFrame(axis, sign) for axis in range(3) for sign in (1, -1)]
ALONG_Y = ProbeFrame(1, 1)
BAR = ball_bar("bar", balls=5, length_mm=600.0, tilt_rad=math.radians(15.0), holder_length_mm=60.0,
               ball_diameter_mm=25.0)  # fmt: skip
PROBE, MOUNT = ProbeGeometry(ram_length_mm=600.0), MountGeometry(table_z_mm=-1500.0)
PLACE = np.array([0.0, 1000.0, 750.0])


def scene_at(frame: ProbeFrame, azimuth_deg: float, elevation_deg: float) -> tuple[NDArray[np.float64], Scene]:
    return measuring_scene(
        BAR, PROBE, MOUNT, frame=frame, location_mm=PLACE,
        azimuth_rad=math.radians(azimuth_deg), elevation_rad=math.radians(elevation_deg),
    )  # fmt: skip


@pytest.mark.parametrize("frame", FRAMES)
def test_the_frame_is_a_rotation_that_brings_the_stylus_to_plus_y(frame: ProbeFrame) -> None:
    rotation = frame.to_frame(np.eye(3)).T
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation @ frame.stylus_axis == pytest.approx([0.0, 1.0, 0.0])
    assert (frame.to_workpiece(frame.to_frame(PLACE)) == PLACE).all()
    assert ProbeFrame.of(180.0 * frame.stylus_axis) == frame
    box = Box((1.0, 2.0, 3.0), (4.0, 6.0, 8.0))
    assert frame.shape_in_workpiece(frame.shape_in_frame(box)) == box
    low, high = frame.withdrawn_corner([(0.0, 10.0)] * 3), frame.withdrawn_corner([(-10.0, 0.0)] * 3)
    assert frame.stylus_axis @ low == pytest.approx(0.0 if frame.sign > 0 else -10.0)
    assert frame.stylus_axis @ high == pytest.approx(-10.0 if frame.sign > 0 else 0.0)


def test_the_case_study_computes_in_the_workpiece_frame_itself() -> None:
    assert (ALONG_Y.to_frame(np.eye(3)) == np.eye(3)).all()


@pytest.mark.parametrize("offset", [[0.0, 0.0, 0.0], [10.0, 250.0, 0.0]])
def test_a_tool_that_is_not_parallel_to_an_axis_is_refused(offset: list[float]) -> None:
    with pytest.raises(DataError, match="not parallel to a machine axis"):
        ProbeFrame.of(offset)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("orientation", [(45.0, 0.0), (120.0, 60.0), (-150.0, 60.0), (135.0, -45.0)])
def test_the_same_balls_are_accessible_to_a_rotated_machine(
    frame: ProbeFrame, orientation: tuple[float, float]
) -> None:
    centres, scene = scene_at(ALONG_Y, *orientation)
    around = [body for body in scene.obstacles if body.name != TABLE]
    masks = [
        accessible_balls(
            frame_of_machine.to_workpiece(centres),
            Scene(PROBE.bodies(frame_of_machine), [_rotated(body, frame_of_machine) for body in around]),
            contact_mm=15.5,
            approach_mm=8.0,
            directions=np.array([frame_of_machine.to_workpiece(row) for row in directions]),
        ).tolist()
        for frame_of_machine in (ALONG_Y, frame)
        for directions in [approach_directions(9, ALONG_Y.stylus_axis)]
    ]
    assert masks[0] == masks[1]


def test_some_of_these_balls_are_accessible_and_some_are_not() -> None:
    found = [
        accessible_balls(
            *scene_at(ALONG_Y, *orientation),
            contact_mm=15.5,
            approach_mm=8.0,
            directions=approach_directions(9, ALONG_Y.stylus_axis),
        )
        for orientation in [(45.0, 0.0), (120.0, 60.0), (-150.0, 60.0), (135.0, -45.0)]
    ]
    assert 0 < np.sum(found) < np.size(found)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("turn", [((-50.0, 10.0), (60.0, -35.0)), ((170.0, 0.0), (-90.0, 80.0))])
def test_the_probe_keeps_its_clearance_while_the_mount_turns(
    frame: ProbeFrame, turn: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    """Waiting points up to the deepest permissible coordinate, against the bodies themselves at random angles."""
    clearance_mm, rng = 9.0, np.random.default_rng(3)
    pose = mount_pose(PLACE, MOUNT, 0.0, 0.0)
    bodies = [*mount_bodies(MOUNT, PLACE, pose), table_body(MOUNT, PLACE, frame)]
    still = [body.shape.translated(point(-PLACE)) for body in bodies if body.name != "shaft"]
    sweep = turn_sweep(cover_turning_bodies(BAR, MOUNT), PROBE, frame, still, *turn, clearance_mm=clearance_mm)
    x, z = rng.uniform(-500.0, 500.0, (2, 25))
    tips = frame.to_workpiece(np.column_stack([x, np.minimum(sweep.at(x, z), 300.0), z]))
    low, high = np.sort(np.array(turn), axis=0)
    for _ in range(12):
        _, scene = scene_at(frame, *rng.uniform(low, high))
        for tip in tips:
            assert scene.clearance(point(PLACE + tip), at_most=clearance_mm + 1.0) >= clearance_mm


@pytest.mark.parametrize(
    ("tool", "axis"),
    [([0, 250, 0], 0), ([0, -250, 0], 0), ([250, 0, 0], 1), ([-250, 0, 0], 1), ([0, 0, -250], 1), ([0, 0, 250], 1)],
)
def test_stations_stand_along_a_horizontal_axis_across_the_stylus(tool: list[float], axis: int) -> None:
    """Without a difference between the stations, the longer travel decides: here that of Y."""
    layout = MeasuringLayout(
        BAR, MOUNT, PROBE, {1: PLACE}, np.array(tool), np.zeros(3), np.array([1000.0, 2000.0, 3000.0]), 15.5, 8.0
    )
    assert layout.station_axis == axis


@pytest.mark.parametrize("frame", [frame for frame in FRAMES if not frame.is_vertical])
def test_a_named_set_lays_the_bar_along_the_same_lines_with_its_holders_towards_the_stylus(frame: ProbeFrame) -> None:
    plain, turned = parse_position_set("S1+S2+S3", 1), parse_position_set("S1+S2+S3", 1, frame.facing_deg)
    for before, after in zip(plain, turned, strict=True):
        poses = [
            mount_pose(np.zeros(3), MOUNT, math.radians(one.azimuth_deg), math.radians(one.elevation_deg)).rotation
            for one in (before, after)
        ]
        holder = frame.to_frame(-poses[1][:, 1])
        assert holder == pytest.approx(-poses[0][:, 1], abs=1e-12)
    lines = [
        {tuple(np.round(np.outer(row, row).ravel(), 9) + 0.0) for row in _bars(positions)}
        for positions in (plain, turned)
    ]
    assert lines[0] == lines[1]


def _bars(positions: Sequence[Position]) -> list[NDArray[np.float64]]:
    angles = [(math.radians(one.azimuth_deg), math.radians(one.elevation_deg)) for one in positions]
    return [mount_pose(np.zeros(3), MOUNT, *pair).rotation[:, 0] for pair in angles]


def test_the_table_is_under_everything_unless_a_horizontal_ram_comes_from_before_it() -> None:
    assert table_body(MOUNT, PLACE, ALONG_Y).shape.lower[1] == 0.0
    for frame in FRAMES:
        shape = table_body(MOUNT, PLACE, frame).shape
        assert shape.upper[2] == MOUNT.table_z_mm
        if frame != ALONG_Y:
            assert min(shape.upper[:2]) > 1e4
            assert max(shape.lower[:2]) < -1e4


def _rotated(body: Body, frame: ProbeFrame) -> Body:
    assert isinstance(body.shape, Capsule)
    return Body(body.name, frame.shape_in_workpiece(body.shape))
