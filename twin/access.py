"""Which balls a straight probe can get at: inside the travel, and with nothing in the way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact import Artefact
from twin.bodies import TIP, ProbeGeometry, artefact_bodies, ball_name, mount_bodies
from twin.collision import Scene
from twin.geometry import Point, added, point
from twin.position_set import MountGeometry, mount_pose

_DIAGONAL = math.sqrt(0.5)


def standing_scene(
    artefact: Artefact,
    probe: ProbeGeometry,
    geometry: MountGeometry,
    *,
    place_mm: Array,
    azimuth_rad: float,
    elevation_rad: float,
) -> tuple[Array, Scene]:
    """Nominal ball centres (N, 3) mm in the workpiece frame, and the scene of all bodies, for one position."""
    pose = mount_pose(place_mm, geometry, azimuth_rad, elevation_rad)
    around = (*artefact_bodies(artefact, geometry, pose), *mount_bodies(geometry, place_mm, pose))
    return pose.applied(artefact.balls), Scene(probe.bodies(), around)


def accessible(
    centres: Array, scene: Scene, *, contact_mm: float, approach_mm: float, clearance_mm: float = 1.0
) -> NDArray[np.bool_]:
    """(N,) bool: balls that can be touched at the pole and at four places of the equator (XZ, turned by 45°).

    `contact_mm` is ball and tip radius together. Probe and ram reach straight back along -Y from every place of
    the tip, so that what is clear there is clear on the way in along Y, too.
    """
    out = contact_mm + approach_mm
    side = out * _DIAGONAL
    offsets: list[Point] = [(0.0, -out, 0.0)]
    offsets += [(x, 0.0, z) for x in (-side, side) for z in (-side, side)]
    return np.array([_clear(scene, index, point(c), offsets, clearance_mm) for index, c in enumerate(centres)])


def _clear(scene: Scene, index: int, centre: Point, offsets: list[Point], clearance_mm: float) -> bool:
    meant = {(TIP, ball_name(index)), ("stem", ball_name(index))}
    return all(
        scene.clearance(added(centre, offset), ignored=meant, at_most=clearance_mm) >= clearance_mm
        for offset in offsets
    )
