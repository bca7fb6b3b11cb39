"""Fast closed-form test for straight moves on which two spheres come too close to each other.

On nearly every path with a collision, the stylus tip comes too close to a ball. It is usually the same ball as on the
previously tested path. This test takes a microsecond and is done before the exact test of all bodies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twin.collision.bodies import Body
from twin.collision.collision import Scene
from twin.collision.geometry import Capsule, Point

CERTAINTY_MARGIN_MM = 1e-6
"""Penetration in mm below which this test reports no collision and leaves the decision to the exact search.

It equals the tolerance of the exact search.
"""
# half the rate at which the squared distance falls; below it the pair hardly approaches, and the quotient is rounding
_CLOSING_MM2 = 1e-6


@dataclass(frozen=True)
class SphereBody:
    """Collision body with the shape of a sphere."""

    name: str
    centre: Point
    radius: float


@dataclass(frozen=True)
class SceneSpheres:
    """Moving bodies and stationary bodies of a collision scene, reduced to those that are spheres."""

    moving: tuple[SphereBody, ...]
    stationary: tuple[SphereBody, ...]

    @classmethod
    def of(cls, scene: Scene) -> SceneSpheres:
        return cls(_spheres(scene.moving), _spheres(scene.obstacles))


class SpherePrefilter:
    """Fast test for pairs of spheres that come closer than their required clearance on a straight move.

    The test finds only some of the collisions that the exact test `Scene.is_free` finds, because it ignores all bodies
    that are not spheres. The clearance of a pair is `clearance_mm`, or a smaller value if `reduced_mm` contains the
    pair. The pair that collided last is tested first.
    """

    def __init__(self, spheres: SceneSpheres, clearance_mm: float, reduced_mm: Mapping[tuple[str, str], float]) -> None:
        self._reaches = [
            (
                *(there - here for here, there in zip(moving.centre, stationary.centre, strict=True)),
                (
                    min(clearance_mm, reduced_mm.get((moving.name, stationary.name), clearance_mm))
                    + (moving.radius + stationary.radius - CERTAINTY_MARGIN_MM)
                ),
            )
            for moving in spheres.moving
            for stationary in spheres.stationary
        ]

    def certainly_hits(self, start: Point, end: Point) -> bool:
        """Return True if two spheres certainly come too close to each other on the straight move from `start` to `end`.

        If the result is False, the exact test of all bodies may still find a collision.
        """
        x, y, z = start
        dx, dy, dz = end[0] - x, end[1] - y, end[2] - z
        square = dx * dx + dy * dy + dz * dz
        # Minimum of |a + s d|² over s in [0, 1], at s = -a·d / d²; only pairs that approach each other count.
        for index, (cx, cy, cz, reach) in enumerate(self._reaches):
            ax, ay, az = x - cx, y - cy, z - cz
            closing = -(ax * dx + ay * dy + az * dz)
            if closing <= _CLOSING_MM2:
                continue
            nearest = min(closing / square, 1.0)
            if ax * ax + ay * ay + az * az + nearest * (nearest * square - 2.0 * closing) < reach * reach:
                # Neighbouring paths mostly hit the same ball, so this pair is tested first the next time.
                self._reaches.insert(0, self._reaches.pop(index))
                return True
        return False


def _spheres(bodies: Sequence[Body]) -> tuple[SphereBody, ...]:
    return tuple(
        SphereBody(body.name, body.shape.a, body.shape.radius)
        for body in bodies
        if isinstance(body.shape, Capsule) and body.shape.a == body.shape.b
    )
