"""Artefact in one position, with the solid bodies by which the preview shows the artefact and its mount.

For each ball that the probe cannot measure, the reason is given.
"""

from __future__ import annotations

import math

import numpy as np

from agent.planning.job import Job
from agent.planning.preview.scene import ArtefactPlacement, PreviewBall
from twin.arrays import Array
from twin.artefact.position_set import Pose, Position, mount_pose
from twin.collision.bodies import TABLE, TIP, Body, artefact_bodies, ball_name, mount_bodies, table_body
from twin.collision.collision import Scene
from twin.collision.geometry import point, separation

_SEARCH_RADIUS_MM = 25.0
"""Largest distance of a probe body from another body that may be named as the obstruction."""


def artefact_placement_of(job: Job, position: Position, *, held_out: bool) -> ArtefactPlacement:
    around = bodies_at(job, position)
    nominal = job.layout.nominal(position)
    centres = nominal + job.tool_offset_mm
    reached = job.layout.reachable(position, nominal)
    elevations = job.layout.elevations(position.station)
    struck = "" if elevations.contains(position.elevation_deg) else f"the artefact would hit the {elevations.obstacle}"
    scene = Scene(job.layout.probe.bodies(job.layout.frame), around)
    balls = tuple(
        PreviewBall(number, point(centre), "" if within else struck or obstruction_of(job, scene, number, axes))
        for number, (centre, axes, within) in enumerate(zip(centres, nominal, reached.tolist(), strict=True))
    )
    return ArtefactPlacement(position, held_out, balls, tuple(body for body in around if body.name != TABLE))


def bodies_at(job: Job, position: Position) -> tuple[Body, ...]:
    """Return the solid bodies around the probe: those of artefact and mount in `position`, the machine table, and the
    bodies at the other stations.

    The mount is at its nominal location.
    """
    place = job.layout.location(position.station)
    pose = _pose(job, position, place)
    geometry = job.layout.mount
    artefact = job.layout.artefact_at(position.station)
    around = job.layout.neighbours.get(position.station, ())
    return (
        *artefact_bodies(artefact, pose),
        *mount_bodies(geometry, place, pose),
        table_body(geometry, place, job.layout.frame),
        *around,
    )


def obstruction_of(job: Job, scene: Scene, number: int, axes_mm: Array) -> str:
    """Return the reason why the probe cannot measure the ball with the number `number`, as text. `scene` contains the
    bodies of the probe and the bodies around it.

    `axes_mm` contains the axis positions in mm at which the stylus tip is at the centre of the ball, shape (3,).
    """
    layout = job.layout
    ends = zip("XYZ", axes_mm.tolist(), layout.lower_mm.tolist(), layout.upper_mm.tolist(), strict=True)
    outside = [
        f"{axis} {_tenths(at)} mm ({low:.1f} to {high:.1f})" for axis, at, low, high in ends if not low <= at <= high
    ]
    if outside:
        return f"outside the travel: {', '.join(outside)}"
    pair = _closest_pair(job, scene, number, axes_mm)
    return f"no access: {pair[0]} too close to {pair[1]}" if pair else "no access: a body obstructs the probe"


def _tenths(value_mm: float) -> str:
    """Return the value as text with one decimal; a tiny negative value gives 0.0, not -0.0."""
    return f"{round(value_mm, 1) + 0.0:.1f}"


def _closest_pair(job: Job, scene: Scene, number: int, axes_mm: Array) -> tuple[str, str] | None:
    """Return the names of the probe body and the other body that are closest with the tip at the start of any touch of
    the ball; None if all are farther apart than the search radius."""
    meant = {(TIP, ball_name(number)), ("stem", ball_name(number))}
    away = job.layout.contact_mm + job.layout.approach_mm
    closest, named = math.inf, None
    for direction in job.rules.probing.directions:
        tip = point(axes_mm + job.tool_offset_mm - away * np.asarray(direction))
        for i, j in scene.near_pairs(tip, tip, _SEARCH_RADIUS_MM):
            pair = (scene.moving[i].name, scene.obstacles[j].name)
            distance = separation(scene.moving[i].shape.translated(tip), scene.obstacles[j].shape)[0]
            if pair not in meant and distance < closest:
                closest, named = distance, pair
    return named


def _pose(job: Job, position: Position, place_mm: Array) -> Pose:
    azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
    return mount_pose(place_mm, job.layout.mount, azimuth, elevation)
