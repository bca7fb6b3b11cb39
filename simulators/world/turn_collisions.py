"""Collisions while a mount turns.

The bodies are checked at successive instants, because the volume that a turning bar sweeps has no simple shape.

A quick test comes first, with spheres that enclose all bodies that turn with the mount. If it passes, there is no
collision. If it fails, nothing is proved, and the bodies themselves are checked.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.roles import MotionState
from simulators.world.controller import Controller
from simulators.world.workpiece import Workpiece
from twin.arrays import Array
from twin.collision.bodies import TABLE, Body
from twin.collision.collision import Scene
from twin.collision.geometry import Capsule, Point, Shape, point, separation, sphere, swept_contact, translate_point
from twin.collision.swept_volume import SphereCover

STEP_MM = 4.0
"""Smallest motion between two checks, in mm; it is less than half the thickness of the thinnest relevant body."""
_SEARCH_RADIUS_MM = 150.0
_ORIGIN: Point = (0.0, 0.0, 0.0)
_STANDING = (TABLE, "pedestal")
INSTANTS = 64
"""Number of samples of a turn, equally spaced in time: about 3° apart for a turn of 180°."""
SLACK_MM = 1.0
"""Required clearance. It allows for wobble and index errors of the mount between two samples, which are far smaller."""


@dataclass(frozen=True)
class TurnCrash:
    time_s: float
    moving: str
    obstacle: str


def first_turn_crash(workpiece: Workpiece, controller: Controller, start_s: float, end_s: float) -> TurnCrash | None:
    """Return the first collision of probe or ram with the turning artefact between the instants `start_s` and `end_s`.

    Returns None if there is no collision. The result is a forecast, which assumes that no other command or fault occurs
    before `end_s`.
    """
    if _stays_outside(workpiece, controller, start_s):
        return None
    speed = math.radians(workpiece.mount.max_speed_deg_per_s) * workpiece.sweep_radius_mm
    if controller.motion is MotionState.MOVING:
        speed += math.hypot(*controller.limits().rapid_mm_per_s)
    elif is_turn_clear(workpiece, _tip(controller, start_s), start_s, end_s):
        return None
    instant = start_s
    while True:
        tip = _tip(controller, instant)
        # No point approaches faster than `speed`, so a gap cannot close before gap / speed. Near contact, STEP_MM
        # bounds the number of checks.
        scene = workpiece.snapshot(instant).scene
        gap_mm = scene.clearance(tip, at_most=_SEARCH_RADIUS_MM)
        pair = _touching(scene, tip) if gap_mm < 0.0 else None
        if pair is not None:
            return TurnCrash(instant, *pair)
        if instant >= end_s:
            return None
        instant = min(end_s, instant + max(gap_mm, STEP_MM) / speed)


def first_mount_collision(turning: Workpiece, other: Workpiece, start_s: float, end_s: float) -> TurnCrash | None:
    """Return the first collision between the bodies of two workpieces, `turning` and `other`, between the instants
    `start_s` and `end_s`, or None.

    The workpiece `other` may turn too. The bodies are checked at successive instants; between two checks the fastest
    parts move at most by the present gap between the bodies, or by the constant `STEP_MM` if the gap is smaller.
    """
    apart = np.hypot(*(turning.location_mm - other.location_mm)[:2])
    if apart > turning.sweep_radius_mm + other.sweep_radius_mm:
        return None
    speed = sum(math.radians(piece.mount.max_speed_deg_per_s) * piece.sweep_radius_mm for piece in (turning, other))
    instant = start_s
    while True:
        # Steps as in `first_turn_crash`; here both workpieces may turn, and their speeds add up.
        gap_mm, pair = _gap(Scene(turning.snapshot(instant).bodies, other.snapshot(instant).bodies))
        if gap_mm <= 0.0:
            return TurnCrash(instant, *pair)
        if instant >= end_s:
            return None
        instant = min(end_s, instant + max(gap_mm, STEP_MM) / speed)


def first_table_collision(workpiece: Workpiece, start_s: float, end_s: float) -> TurnCrash | None:
    """Return the first collision of the turning artefact with the machine table between the instants `start_s` and
    `end_s`, or None.

    The artefact is checked at successive instants; between two checks its fastest parts move at most by the present gap
    from the table, or by the constant `STEP_MM` if the gap is smaller. A hanging mount has the table above it.
    """
    speed = math.radians(workpiece.mount.max_speed_deg_per_s) * workpiece.sweep_radius_mm
    instant = start_s
    while True:
        bodies = workpiece.snapshot(instant).bodies
        gap_mm, nearest = _gap_to_table(bodies, hanging=workpiece.hanging)
        if gap_mm <= 0.0:
            return TurnCrash(instant, nearest, TABLE)
        if instant >= end_s:
            return None
        instant = min(end_s, instant + max(gap_mm, STEP_MM) / speed)


def _gap_to_table(bodies: Sequence[Body], *, hanging: bool) -> tuple[float, str]:
    """Return the vertical distance in mm of the turning body that is nearest to the table, and its name."""
    table = next(body.shape for body in bodies if body.name == TABLE)
    turning = [body for body in bodies if not body.name.startswith(_STANDING)]
    if hanging:
        return min((table.lower[2] - body.shape.upper[2], body.name) for body in turning)
    return min((body.shape.lower[2] - table.upper[2], body.name) for body in turning)


def _gap(scene: Scene) -> tuple[float, tuple[str, str]]:
    """Return the smallest distance in mm between any two bodies and their names, searched up to `_SEARCH_RADIUS_MM`.

    The table is excluded, because it carries both workpieces.
    """
    smallest, pair = _SEARCH_RADIUS_MM, ("", "")
    for i, j in scene.near_pairs(_ORIGIN, _ORIGIN, _SEARCH_RADIUS_MM):
        body, obstacle = scene.moving[i], scene.obstacles[j]
        if TABLE not in (body.name, obstacle.name):
            distance = separation(body.shape, obstacle.shape)[0]
            if distance < smallest:
                smallest, pair = distance, (body.name, obstacle.name)
    return smallest, pair


def _stays_outside(workpiece: Workpiece, controller: Controller, start_s: float) -> bool:
    """Return True if no body of the probe enters the sphere that contains the artefact at all its angles."""
    reach = sphere(point(workpiece.location_mm), workpiece.sweep_radius_mm)
    tip, end = _tip(controller, start_s), _tip(controller, math.inf)
    displacement = (end[0] - tip[0], end[1] - tip[1], end[2] - tip[2])
    for body in workpiece.probe_bodies:
        here = body.shape.translated(tip)
        if separation(here, reach)[0] <= 0.0 or swept_contact(here, reach, displacement) is not None:
            return False
    return True


def _tip(controller: Controller, instant_s: float) -> Point:
    """Return the tip centre according to the displayed axis positions."""
    return translate_point(controller.displayed_at(instant_s), controller.tool_offset)


def _touching(scene: Scene, tip: Point) -> tuple[str, str] | None:
    """Return the names of the first pair of bodies that overlap if the tip centre is at `tip`, or None."""
    for i, j in scene.near_pairs(tip, tip):
        if separation(scene.moving[i].shape.translated(tip), scene.obstacles[j].shape)[0] < 0.0:
            return scene.moving[i].name, scene.obstacles[j].name
    return None


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
    # The axis of a capsule lies in the bounding box shrunk by the radius. The distance from the shrunk box, minus the
    # radius, is therefore a lower bound.
    beyond = np.maximum(
        np.maximum(np.array(shape.lower) + radius - points, points - np.array(shape.upper) + radius), 0.0
    )
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", beyond, beyond)) - radius)
