"""Nominal geometry of a proposed artefact: ball centres, and the solid parts that carry their holders.

The artefact is described in the frame of a horizontal spindle, in which the holders point along -Y and the mount is
fixed at the origin. For a vertical spindle it is turned about X until the holders point against the stylus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

from agent.planning.new_machine.artefact_setup import (
    BALL_PLATE,
    PLATE_THICKNESS_MM,
    TETRAHEDRON,
    TILTED_FROM_MM,
    ArtefactSetup,
)
from twin.artefact.artefact import bar_balls
from twin.collision.probe_frame import ProbeFrame

Vector = tuple[float, float, float]

PLATE_MARGIN_MM = 25.0
"""Width of a plate beyond its outer balls."""
ROD_RADII_MM = (6.0, 10.0)
"""Radius of the rods of a small and of a large tetrahedron."""


@dataclass(frozen=True)
class SolidPart:
    """Solid part: a rod of `radius_mm` between two points or, if the radius is 0, a box between two corners."""

    name: str
    start_mm: Vector
    end_mm: Vector
    radius_mm: float = 0.0


@dataclass(frozen=True)
class ArtefactGeometry:
    """Ball centres and solid parts of an artefact in its own frame, in mm. A bar has no `parts`: its beam is known."""

    balls: tuple[Vector, ...]
    parts: tuple[SolidPart, ...] = ()

    def turned(self, spindle: ProbeFrame) -> ArtefactGeometry:
        """Return the geometry whose holders point against the stylus of this spindle."""
        return ArtefactGeometry(
            tuple(turned(ball, spindle) for ball in self.balls),
            tuple(_turned_part(part, spindle) for part in self.parts),
        )


def artefact_geometry(artefact: ArtefactSetup) -> ArtefactGeometry:
    """Return the nominal geometry of an artefact whose holders point along -Y."""
    if artefact.shape == BALL_PLATE:
        return _plate(artefact)
    if artefact.shape == TETRAHEDRON:
        return _tetrahedron(artefact)
    centres = bar_balls(artefact.balls, artefact.size_mm, math.radians(artefact.tilt_deg), artefact.holder_mm)
    return ArtefactGeometry(tuple((x, y, z) for x, y, z in centres.tolist()))


def reference_pair(artefact: ArtefactSetup) -> tuple[int, int]:
    """Return the numbers of the two balls whose distance is the certified length: the end balls of a bar, opposite
    corners of a plate, two corners of a tetrahedron."""
    return (0, 1) if artefact.shape == TETRAHEDRON else (0, artefact.balls - 1)


def nominal_length_mm(artefact: ArtefactSetup) -> float:
    """Return the nominal distance of the two balls of `reference_pair` in mm."""
    balls = artefact_geometry(artefact).balls
    first, second = reference_pair(artefact)
    return math.dist(balls[first], balls[second])


def turned(vector: Vector, spindle: ProbeFrame) -> Vector:
    """Return `vector`, which belongs to an artefact for a horizontal spindle, rotated for `spindle`."""
    if not spindle.is_vertical:
        return vector
    x, y, z = vector
    return x, -spindle.sign * z, spindle.sign * y


def _turned_part(part: SolidPart, spindle: ProbeFrame) -> SolidPart:
    start, end = turned(part.start_mm, spindle), turned(part.end_mm, spindle)
    if part.radius_mm > 0.0:
        return SolidPart(part.name, start, end, part.radius_mm)
    lower = (min(start[0], end[0]), min(start[1], end[1]), min(start[2], end[2]))
    upper = (max(start[0], end[0]), max(start[1], end[1]), max(start[2], end[2]))
    return SolidPart(part.name, lower, upper)


def _plate(artefact: ArtefactSetup) -> ArtefactGeometry:
    count = math.isqrt(artefact.balls)
    pitch, half = artefact.size_mm / (count - 1), 0.5 * artefact.size_mm
    out = -(PLATE_THICKNESS_MM + artefact.holder_mm)
    balls = tuple((column * pitch - half, out, row * pitch - half) for row in range(count) for column in range(count))
    edge = half + PLATE_MARGIN_MM
    return ArtefactGeometry(balls, (SolidPart("plate", (-edge, -PLATE_THICKNESS_MM, -edge), (edge, 0.0, edge)),))


def _tetrahedron(artefact: ArtefactSetup) -> ArtefactGeometry:
    half, around = 0.5 * artefact.size_mm, artefact.size_mm / math.sqrt(3.0)
    corners: tuple[Vector, ...] = (
        (-half, 0.0, -0.5 * around), (half, 0.0, -0.5 * around), (0.0, 0.0, around), (0.0, -artefact.height_mm, 0.0),
    )  # fmt: skip
    radius = ROD_RADII_MM[artefact.size_mm >= TILTED_FROM_MM]
    pairs = tuple(combinations(range(4), 2))
    feet = (
        corners if artefact.balls == len(corners) else (*corners, *(_middle(corners[i], corners[j]) for i, j in pairs))
    )
    edges = tuple(SolidPart(f"edge {i}-{j}", corners[i], corners[j], radius) for i, j in pairs)
    spokes = tuple(SolidPart(f"spoke {i}", (0.0, 0.0, 0.0), corners[i], radius) for i in range(3))
    return ArtefactGeometry(tuple((x, y - artefact.holder_mm, z) for x, y, z in feet), (*edges, *spokes))


def _middle(one: Vector, other: Vector) -> Vector:
    return 0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1]), 0.5 * (one[2] + other[2])
