"""Conservative test for collisions during a turn of a mount.

The test uses spheres that enclose all bodies that turn with the mount. A passed test proves that there is no collision.
A failed test proves nothing, and the caller must then check the bodies themselves.
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
"""Number of samples of a turn, equally spaced in time: about 3° apart for a turn of 180°."""
SLACK_MM = 1.0
"""Required clearance. It allows for wobble and index errors of the mount between two samples, which are far smaller."""


def is_turn_clear(workpiece: Workpiece, tip: Point, start_s: float, end_s: float) -> bool:
    """Return True if the turning artefact certainly stays clear of the probe between the instants `start_s` and
    `end_s`.

    During the turn the centre of the stylus tip rests at `tip`, in mm. The bodies that do not turn (pedestal and table)
    are checked only once.
    """
    cover = workpiece.cover
    if cover is None:
        return False
    if workpiece.snapshot(start_s).scene.clearance(tip, at_most=SLACK_MM) < SLACK_MM:
        return False
    angles = np.array(
        [workpiece.true_angles_rad(instant) for instant in np.linspace(start_s, end_s, INSTANTS).tolist()]
    )
    centres, radii = _rotate_cover(cover, angles)
    centres += workpiece.location_mm - np.array(tip)
    return _least_gap(centres, radii, workpiece.probe_bodies) >= SLACK_MM


def _rotate_cover(cover: SphereCover, angles_rad: Array) -> tuple[Array, Array]:
    """Return sphere centres (n, m, 3) relative to the mount's location at `angles_rad` (n, 2), and radii (n, m).

    The radii are enlarged to contain all positions up to the next sample.
    """
    x, y, z = cover.centres.T
    azimuth, elevation = angles_rad.T[:, :, None]
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    # Tilt by the elevation in the X-Z plane, then rotation about Z by the azimuth.
    across = x * ce - z * se
    centres = np.stack([across * ca - y * sa, across * sa + y * ca, x * se + z * ce], axis=-1)
    further = np.abs(np.diff(angles_rad, axis=0, append=angles_rad[-1:]))
    # Chord ≤ arc: a sphere moves at most Δazimuth * |p| + Δelevation * hypot(x, z) until the next sample.
    radii = cover.radii + further[:, :1] * np.sqrt(x**2 + y**2 + z**2) + further[:, 1:] * np.hypot(x, z)
    return centres, radii


def _least_gap(centres: Array, radii: Array, bodies: Iterable[Body]) -> float:
    """Return a lower bound in mm of the distance between spheres and bodies, with a bounding box in place of each
    body.
    """
    return min(float((_distance(centres, body.shape) - radii).min()) for body in bodies)


def _distance(points: Array, shape: Shape) -> Array:
    """Return lower bounds (...) in mm of the distances between `points` (..., 3) and the body `shape`."""
    radius = shape.radius if isinstance(shape, Capsule) else 0.0
    beyond = np.maximum(
        np.maximum(np.array(shape.lower) + radius - points, points - np.array(shape.upper) + radius), 0.0
    )
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", beyond, beyond)) - radius)
