"""Drawn features of workpieces, and their true errors on a machine whose error field is known.

The true errors come from the displaced points themselves: a length between them, a circle, a plane or a rigid motion
fitted to them. Nothing of the linear forms of `twin.workpiece` is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.workpiece import features as make
from twin.workpiece.features import Feature

LENGTHS_MM = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0)
_DATUM = np.array([[0.0, 0.0, 0.0], [600.0, 0.0, 0.0], [600.0, 400.0, 0.0], [0.0, 400.0, 0.0]])

Field = Callable[[np.ndarray], np.ndarray]
"""Function that returns the displacements (n, 3) in mm at points (n, 3)."""


@dataclass(frozen=True, eq=False)
class DrawnFeature:
    """Feature with the name of its group, the datum features that belong to it, and a function that returns its true
    error in mm in a field of displacements."""

    group: str
    feature: Feature
    datum: tuple[Feature, ...]
    true_error: Callable[[Field], float]


def draw(low: np.ndarray, high: np.ndarray, each: int, rng: np.random.Generator) -> list[DrawnFeature]:
    """Draw `each` features of every group between the corners `low` and `high` (3,) of the workspace, in mm."""
    drawn = [_distance(*_line(low, high, length, rng), length) for length in LENGTHS_MM for _ in range(each)]
    for _ in range(each):
        drawn.append(_diameter(low, high, rng))
        drawn.append(_position(low, high, rng))
        drawn.append(_flatness(low, high, rng))
    return drawn


def _line(
    low: np.ndarray, high: np.ndarray, length_mm: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    while True:
        direction = rng.standard_normal(3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)]
        first = rng.uniform(low, high)
        second = first + length_mm * direction / np.linalg.norm(direction)
        if (second > low).all() and (second < high).all():
            return first, second


def _distance(first: np.ndarray, second: np.ndarray, length_mm: float) -> DrawnFeature:
    ends = np.stack((first, second))

    def true_error(field: Field) -> float:
        moved = ends + field(ends)
        return float(np.linalg.norm(moved[1] - moved[0]) - np.linalg.norm(ends[1] - ends[0]))

    return DrawnFeature(f"distance {length_mm:g} mm", make.distance("distance", first, second), (), true_error)


def _diameter(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> DrawnFeature:
    size = float(rng.uniform(20.0, 400.0))
    centre = rng.uniform(low + 200.0, high - 200.0)
    normal = int(rng.integers(3))
    others = [axis for axis in range(3) if axis != normal]
    angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    circle = np.tile(centre, (72, 1))
    circle[:, others] += 0.5 * size * np.stack((np.cos(angles), np.sin(angles)), axis=1)

    def true_error(field: Field) -> float:
        x, y = (circle + field(circle))[:, others].T
        # Kåsa: x² + y² = 2 a x + 2 b y + c, about the nominal centre to keep the numbers small
        x, y = x - centre[others[0]], y - centre[others[1]]
        a, b, c = np.linalg.lstsq(np.stack((2.0 * x, 2.0 * y, np.ones_like(x)), axis=1), x**2 + y**2, rcond=None)[0]
        return 2.0 * float(np.sqrt(c + a**2 + b**2)) - size

    return DrawnFeature("diameter", make.diameter("bore", centre, np.eye(3)[normal], size), (), true_error)


def _position(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> DrawnFeature:
    origin = rng.uniform(low, high - [600.0, 400.0, 400.0])
    datum = origin + _DATUM
    hole = origin + rng.uniform([0.0, 0.0, 0.0], [600.0, 400.0, 400.0])

    def true_error(field: Field) -> float:
        moved, at = datum + field(datum), hole + field(hole[None, :])[0]
        # Kabsch: the rotation and translation that bring the displaced datum points back best
        left, right = moved - moved.mean(axis=0), datum - datum.mean(axis=0)
        u, _, vt = np.linalg.svd(left.T @ right)
        rotation = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt).T
        seen = rotation @ (at - moved.mean(axis=0)) + datum.mean(axis=0)
        return 2.0 * float(np.hypot(*(seen - hole)[:2]))

    points = tuple(make.datum(f"datum {n}", one) for n, one in enumerate(datum))
    return DrawnFeature("position", make.position("hole", hole, [0.0, 0.0, 1.0]), points, true_error)


def _flatness(low: np.ndarray, high: np.ndarray, rng: np.random.Generator) -> DrawnFeature:
    sides = rng.uniform(150.0, 800.0, 2)
    centre = rng.uniform(low + 400.0, high - 400.0)
    shares = np.linspace(-0.5, 0.5, 9)
    u, v = (one.reshape(-1) for one in np.meshgrid(sides[0] * shares, sides[1] * shares))
    face = centre + np.stack((u, v, np.zeros_like(u)), axis=1)

    def true_error(field: Field) -> float:
        moved = face + field(face)
        moved -= moved.mean(axis=0)
        normal = np.linalg.svd(moved, full_matrices=False)[2][2]
        return float(np.ptp(moved @ normal))

    feature = make.flatness("face", centre, [0.0, 0.0, 1.0], (float(sides[0]), float(sides[1])))
    return DrawnFeature("flatness", feature, (), true_error)
