"""Spheres that pass spheres: which of many straight moves certainly come too near, in closed form and all at once.

Nearly every way that is not free brings the stylus tip too near to a ball. To say so for all of them together costs no
more than the exact search does for one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.bodies import Body
from twin.collision import Scene
from twin.geometry import Capsule

SURELY_MM = 1e-6
"""What comes too near by less is left to the exact search: its own tolerance."""
_CLOSING_MM2 = 1e-6
_NO_WAY_MM2 = 1e-300


@dataclass(frozen=True)
class Ball:
    """A body that is a sphere."""

    name: str
    shape: Capsule


@dataclass(frozen=True, eq=False)
class Spheres:
    """Of a scene: the `moving` ones, and the standing ones at `centres` (M, 3), the place of each by its name."""

    moving: Sequence[Ball]
    places: Mapping[str, int]
    centres: Array
    radii: Array

    @classmethod
    def of(cls, scene: Scene) -> Spheres:
        moving, standing = _spheres(scene.moving), _spheres(scene.obstacles)
        return cls(
            moving,
            {ball.name: place for place, ball in enumerate(standing)},
            np.array([ball.shape.a for ball in standing]).reshape(-1, 3),
            np.array([ball.shape.radius for ball in standing]),
        )

    def too_near(
        self, starts: Array, ends: Array, clearance_mm: float, closer: Mapping[tuple[str, str], float]
    ) -> NDArray[np.bool_]:
        """(m,) bool: moves of the tip from `starts` (m, 3) to `ends` (m, 3) on which `Scene.free` finds two spheres too
        near to each other for certain; the rest may be free or not. Arguments as there."""
        hit = np.zeros(len(starts), dtype=np.bool_)
        if not len(self.radii):
            return hit
        for ball in self.moving:
            apart = np.full(len(self.radii), clearance_mm)
            for (moving, obstacle), apart_mm in closer.items():
                if moving == ball.name and obstacle in self.places:
                    apart[self.places[obstacle]] = min(clearance_mm, apart_mm)
            reach = apart + self.radii + ball.shape.radius
            hit |= _pass_within(starts, ends, self.centres - ball.shape.a, reach - SURELY_MM)
        return hit


def _pass_within(starts: Array, ends: Array, centres: Array, reach: Array) -> NDArray[np.bool_]:
    """(m,): whether a point on its way comes closer to any centre, and within its reach (M,)."""
    way = ends - starts
    square = _squared(way)[:, None]
    # From each centre to the start: how far along the way (negative: it closes in), and how far in all, squared.
    opening = np.einsum("ij,ij->i", starts, way)[:, None] - way @ centres.T
    away = _squared(starts)[:, None] - 2.0 * (starts @ centres.T) + _squared(centres)
    nearest = np.minimum(-opening / np.maximum(square, _NO_WAY_MM2), 1.0)
    least = away + nearest * (2.0 * opening + nearest * square)
    return np.asarray(((opening < -_CLOSING_MM2) & (least < reach**2)).any(axis=1))


def _squared(vectors: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", vectors, vectors))


def _spheres(bodies: Sequence[Body]) -> list[Ball]:
    return [
        Ball(body.name, body.shape)
        for body in bodies
        if isinstance(body.shape, Capsule) and body.shape.a == body.shape.b
    ]
