"""Bodies for the collision check. The moving bodies are the probe and the ram. The stationary bodies are the artefact,
the mount and the table.

The coordinates of the moving bodies are relative to the centre of the stylus tip. The probe and the ram point along a
machine axis. The machine has only linear axes, so these bodies never rotate. The coordinates of the stationary bodies
are in the workpiece frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.artefact_body import Rod
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Pose
from twin.collision.geometry import Box, Capsule, Shape, point, sphere
from twin.collision.probe_frame import ProbeFrame
from twin.immutable import Immutable

TIP = "tip"
TABLE = "table"
TABLE_THICKNESS_MM = 500.0
TABLE_SPAN_MM = 1e5


@dataclass(frozen=True)
class Body(Immutable):
    name: str
    shape: Shape


def ball_name(index: int) -> str:
    """Return the name of the collision body of a ball. The balls are counted from 0, as in the artefact file."""
    return f"ball {index}"


def post_name(index: int) -> str:
    """Return the name of the collision body of a ball's holder. The balls are counted from 0."""
    return f"post {index}"


def artefact_bodies(artefact: Artefact, pose: Pose) -> tuple[Body, ...]:
    """Return the balls and the other solid parts of the artefact at `pose` as collision bodies in the workpiece frame.

    A rod that carries holders is divided into pieces, each from one holder to the next. The bounding boxes of the short
    pieces of an oblique rod enclose less empty space than one box around the whole rod. The first step of a collision
    check, which compares bounding boxes, therefore excludes more pairs of bodies.
    """
    centres = pose.apply(artefact.balls)
    feet = artefact.body.feet(artefact.balls)
    balls = [Body(ball_name(i), sphere(point(c), artefact.ball_radius_mm)) for i, c in enumerate(centres)]
    posts = [
        Body(post_name(i), Capsule(point(foot), point(centre), artefact.body.holder_radius_mm))
        for i, (foot, centre) in enumerate(zip(pose.apply(feet), centres, strict=True))
    ]
    carriers = artefact.body.carriers(artefact.balls)
    return (*balls, *posts, *(piece for rod in carriers for piece in _pieces(rod, feet, pose)))


def mount_bodies(geometry: MountGeometry, location_mm: Array, pose: Pose) -> tuple[Body, ...]:
    """Return the collision bodies of a mount at `location_mm` (3,), which are its shaft and its pedestal. A part whose
    radius is 0 does not exist."""
    location = point(location_mm)
    x, y, z = location
    parts = (
        ("shaft", Capsule(location, point(pose.centre), geometry.shaft_radius_mm)),
        (
            "pedestal",
            Capsule(
                (x, y, geometry.table_z_mm), (x, y, z + geometry.up * geometry.head_mm), geometry.pedestal_radius_mm
            ),
        ),
    )
    return tuple(Body(name, shape) for name, shape in parts if shape.radius > 0.0)


def table_body(geometry: MountGeometry, location_mm: Array, frame: ProbeFrame) -> Body:
    """Return the body of the machine table under a mount at `location_mm` (3,). `frame` gives the direction of the
    stylus.

    The table is a horizontal slab without limits; a hanging mount hangs from its lower side. Exception: under a
    horizontal stylus that points from the origin of the workpiece frame towards the mount, the table begins at the
    origin, because the ram of such a machine moves in front of the table and may be lower than its surface.
    """
    surface = geometry.table_z_mm
    bottom, top = sorted((surface, surface - geometry.up * TABLE_THICKNESS_MM))
    lower = [-TABLE_SPAN_MM, -TABLE_SPAN_MM, bottom]
    upper = [TABLE_SPAN_MM, TABLE_SPAN_MM, top]
    if not frame.is_vertical and frame.sign * float(location_mm[frame.axis]) > 0.0:
        (lower if frame.sign > 0 else upper)[frame.axis] = 0.0
    return Body(TABLE, Box(point(lower), point(upper)))


def _pieces(rod: Rod, feet: Array, pose: Pose) -> list[Body]:
    """Return the rod at `pose`, divided at the feet (N, 3) of holders that stand on its axis, except the outer two."""
    base, axis, first, last = rod.line
    along = feet @ axis
    beside = np.linalg.norm(feet - base - along[:, None] * axis, axis=1)
    standing = np.unique(along[(beside < rod.radius_mm) & (along > first) & (along < last)])
    origin, direction = pose.apply(base[None])[0], pose.rotation @ axis
    ends = [point(origin + stop * direction) for stop in (first, *standing[1:-1].tolist(), last)]
    return [Body(rod.name, Capsule(a, b, rod.radius_mm)) for a, b in pairwise(ends)]
