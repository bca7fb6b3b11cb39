"""Accessibility of balls for a straight probe.

A ball is accessible if no collision occurs on the approach, during the touches and between them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import mount_pose
from twin.collision.bodies import TIP, Body, artefact_bodies, ball_name, mount_bodies, table_body
from twin.collision.collision import Scene
from twin.collision.geometry import Box, Capsule, Point, point, translate_point
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry

AT_CONTACT_MM = 0.5
"""Clearance in mm during the touch itself.

It can be small, because the touched ball locates the tip, and the ball's holder is fixed to the ball.
"""

_Leg = tuple[Point, Point]


def measuring_scene(
    artefact: Artefact,
    probe: ProbeGeometry,
    geometry: MountGeometry,
    *,
    frame: ProbeFrame,
    location_mm: Array,
    azimuth_rad: float,
    elevation_rad: float,
    other_bodies: Sequence[Body] = (),
) -> tuple[Array, Scene]:
    """Return the nominal ball centres (N, 3) of the artefact in one position, in mm in the workpiece frame, and the
    collision scene of this position.

    The scene contains the probe, the artefact, the mount, the table, and `other_bodies` in the workspace. `frame` gives
    the direction of the stylus.
    """
    pose = mount_pose(location_mm, geometry, azimuth_rad, elevation_rad)
    around = (
        *artefact_bodies(artefact, pose),
        *mount_bodies(geometry, location_mm, pose),
        table_body(geometry, location_mm, frame),
        *other_bodies,
    )
    return pose.apply(artefact.balls), Scene(probe.bodies(frame), around)


def accessible_balls(
    centres: Array,
    scene: Scene,
    *,
    contact_mm: float,
    approach_mm: float,
    directions: Array,
    clearance_mm: float = 1.0,
    overtravel_mm: float = 0.0,
) -> NDArray[np.bool_]:
    """Return a boolean array with one element per ball in `centres`. An element is True if its ball can be touched
    along all `directions` (k, 3) without a collision.

    The first direction is that of the touch at the pole, the point of the ball that faces the stylus; it is the
    direction of the stylus. `contact_mm` is
    the ball radius plus the tip radius. A touch begins at the distance `approach_mm` outside contact and stops at the
    distance `overtravel_mm` beyond contact.

    All moves at a ball are checked. The probe moves along the stylus axis from a plane in front of the ball to the
    start of each touch, and from there to the end of the touch. Between two touches it moves in the plane in front of
    the ball.

    The probe and the ram extend straight back from the tip, against the direction of the stylus. During the approach
    along the stylus, they therefore follow the tip through the same volume, and only the tip has to be checked. The
    volume that it sweeps is represented by a tip that is elongated backwards.
    """
    frame = ProbeFrame.of(np.rint(directions[0]))
    # Tip centres relative to the ball centre: start of each touch, and its projection into the plane before the ball.
    out = contact_mm + approach_mm
    starts = -directions * out
    flat = frame.to_frame(starts)
    lengths = [round(length, 6) for length in (flat[:, 1] + out).tolist()]
    flat[:, 1] = -out
    before = frame.to_workpiece(flat)
    touching = _legs(starts, -directions * (contact_mm - overtravel_mm))
    between = _legs(before[:-1], before[1:])
    # The lengths are rounded so that each latitude has one scene.
    elongated = {
        length: Scene(_with_long_tip(scene.moving, frame, length), scene.obstacles) for length in dict.fromkeys(lengths)
    }
    begins = list(zip(lengths, (point(start) for start in starts), strict=True))

    longest = elongated[max(elongated)]
    moved = frame.shape_in_workpiece(Box((-out, -out, -out), (out, 0.0, out)))

    def free(index: int, centre: Point) -> bool:
        expected = {(TIP, ball_name(index)), ("stem", ball_name(index))}
        lower, upper = translate_point(centre, moved.lower), translate_point(centre, moved.upper)
        if not any(_unexpected_pairs(longest, lower, upper, clearance_mm, expected)):
            return True
        return all(
            elongated[length].clearance(translate_point(centre, begin), ignored=expected, at_most=clearance_mm)
            >= clearance_mm
            for length, begin in begins
        ) and not any(
            scene.first_hit(
                translate_point(centre, a), translate_point(centre, b), clearance_mm=apart_mm, ignored=expected
            )
            for legs, apart_mm in ((touching, min(clearance_mm, AT_CONTACT_MM)), (between, clearance_mm))
            for a, b in legs
        )

    return np.array([free(index, point(centre)) for index, centre in enumerate(centres)])


def _legs(starts: Array, ends: Array) -> list[_Leg]:
    return [(point(start), point(end)) for start, end in zip(starts, ends, strict=True)]


def _with_long_tip(moving: tuple[Body, ...], frame: ProbeFrame, length_mm: float) -> list[Body]:
    radius = next(body.shape.radius for body in moving if body.name == TIP and isinstance(body.shape, Capsule))
    long_tip = frame.shape_in_workpiece(Capsule((0.0, 0.0, 0.0), (0.0, -length_mm, 0.0), radius))
    return [Body(TIP, long_tip) if body.name == TIP else body for body in moving]


def _unexpected_pairs(
    scene: Scene, lower: Point, upper: Point, clearance_mm: float, expected: set[tuple[str, str]]
) -> list[bool]:
    """Return a list with one True for each pair of bodies whose boxes overlap in the region, except `expected` pairs.

    No exact distances are computed.
    """
    pairs = scene.near_pairs(lower, upper, clearance_mm)
    return [True for i, j in pairs if (scene.moving[i].name, scene.obstacles[j].name) not in expected]
