"""Whether a turn surely meets nothing: one look at balls around all that turns, and no bodies at each instant.

A proof, no search: where it fails, nobody knows yet, and who asks has to look at the bodies themselves.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from simulators.world.workpiece import Workpiece
from twin.arrays import Array
from twin.collision.bodies import Body
from twin.collision.geometry import Capsule, Point, Shape
from twin.collision.swept_volume import SphereCover

INSTANTS = 64
"""Samples of a turn, evenly in time: with 180° about 3° at a time."""
SLACK_MM = 1.0
"""For what a pose is off between two samples: wobble and index errors of the mount, which are far smaller."""


def is_turn_clear(workpiece: Workpiece, tip: Point, start_s: float, end_s: float) -> bool:
    """Whether nothing of the artefact comes to the probe, the tip centre resting at `tip`, in a span of time.

    What does not turn (pedestal, table) is looked at once.
    """
    cover = workpiece.cover
    if cover is None:
        return False
    if workpiece.snapshot(start_s).scene.clearance(tip, at_most=SLACK_MM) < SLACK_MM:
        return False
    angles = np.array(
        [workpiece.true_angles_rad(instant) for instant in np.linspace(start_s, end_s, INSTANTS).tolist()]
    )
    centres, radii = _turned(cover, angles)
    centres += workpiece.location_mm - np.array(tip)
    return _least_gap(centres, radii, workpiece.probe_bodies) >= SLACK_MM


def _turned(cover: SphereCover, angles_rad: Array) -> tuple[Array, Array]:
    """Balls (n, m, 3) relative to the place at `angles_rad` (n, 2), and radii (n, m) that hold all until the next."""
    x, y, z = cover.centres.T
    azimuth, elevation = angles_rad.T[:, :, None]
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    across = x * ce - z * se
    centres = np.stack([across * ca - y * sa, across * sa + y * ca, x * se + z * ce], axis=-1)
    further = np.abs(np.diff(angles_rad, axis=0, append=angles_rad[-1:]))
    radii = cover.radii + further[:, :1] * np.sqrt(x**2 + y**2 + z**2) + further[:, 1:] * np.hypot(x, z)
    return centres, radii


def _least_gap(centres: Array, radii: Array, bodies: Iterable[Body]) -> float:
    """Smallest distance in mm of balls and bodies, each taken for the box around its axis: never too large."""
    return min(float((_distance(centres, body.shape) - radii).min()) for body in bodies)


def _distance(points: Array, shape: Shape) -> Array:
    """(...) mm of points (..., 3) from what is never smaller than `shape`."""
    radius = shape.radius if isinstance(shape, Capsule) else 0.0
    beyond = np.maximum(
        np.maximum(np.array(shape.lower) + radius - points, points - np.array(shape.upper) + radius), 0.0
    )
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", beyond, beyond)) - radius)
