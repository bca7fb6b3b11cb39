"""Balls by which an artefact that is placed by hand is located.

Before it is located, the artefact may be displaced, turned or missing altogether. The probe therefore comes down
along the stylus, slowly, and only its tip may meet the artefact, because only the tip trips the probe. This module
selects balls for which that is certain.

- The first ball is high enough: while the tip is at its height, every other part of the probe is above the highest part
  of the artefact.
- At the second ball, the artefact stands as the first ball shows, but it may be turned about the vertical by any angle.
  The descent of the probe is checked against the artefact at angles all around.
- With both found where they are expected, the artefact is located up to the rotation about the line through them. A
  third ball determines this rotation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.pose_alignment import choose_third_ball
from twin.artefact.position_set import Pose, Position, mount_pose
from twin.collision.bodies import TIP, Body, artefact_bodies
from twin.collision.collision import Scene
from twin.collision.geometry import Shape, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.errors import DataError

CLEARANCE_MM = 5.0
"""Least distance in mm of the other parts of the probe from the artefact, while it is being located."""
MIN_SPAN_SHARE = 0.3
"""The second ball is at least this share of the artefact's largest ball distance away from the first."""

EQUALLY_HIGH_MM = 12.0
"""Difference in height up to which one ball may be mistaken for another."""
# at 100 mm from the vertical, 3° are 5 mm, as much as the clearance
_TURN_DEG = 3.0
_MOVING_WITH_TIP = (TIP, "stem")  # the stem follows the tip along the stylus and is thinner


@dataclass(frozen=True)
class LocatingBalls:
    """Numbers of the balls by which the artefact is located, in measuring order. `third` is None on a bar."""

    first: int
    second: int
    third: int | None

    @property
    def all(self) -> tuple[int, ...]:
        pair = (self.first, self.second)
        return pair if self.third is None else (*pair, self.third)


def locating_balls(layout: MeasuringLayout, position: Position, balls: Sequence[int]) -> LocatingBalls:
    """Return the balls among `balls` by which the artefact in `position` is located.

    Raises DataError if there is no choice for which only the stylus tip can meet the artefact.
    """
    key = (position.azimuth_deg, position.elevation_deg, tuple(balls))
    if key not in layout.locating:
        layout.locating[key] = _choose(_Approach(layout, position), balls).all
    first, second, *third = layout.locating[key]
    return LocatingBalls(first, second, third[0] if third else None)


def top_mm(layout: MeasuringLayout, position: Position) -> float:
    """Return the height in mm of the highest part of the artefact in `position`, measured from the origin of the
    workpiece frame against the direction of the stylus."""
    return _Approach(layout, position).top_mm


def depth_in_table_mm(layout: MeasuringLayout, position: Position) -> float:
    """Return how far the lowest part of the artefact in `position` is below the surface of the table, in mm; negative
    if it is above."""
    azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
    pose = mount_pose(layout.location(position.station), layout.mount, azimuth, elevation)
    bodies = artefact_bodies(layout.artefact_at(position.station), pose)
    return layout.mount.table_z_mm - min(body.shape.lower[2] for body in bodies)


def _choose(approach: _Approach, balls: Sequence[int]) -> LocatingBalls:
    centres = approach.centres
    first = max(balls, key=lambda ball: (round(approach.height_mm(ball)), approach.off_centre_mm(ball)), default=None)
    if first is None or not approach.is_high(first):
        raise DataError(
            "the artefact cannot be located safely: no ball is so high that only the stylus tip can meet the artefact",
            hint="place it so that an accessible ball is at its top, or use a longer stylus (probe.stem_length_mm)",
        )
    distances = np.linalg.norm(centres - centres[first], axis=1)
    farthest = float(distances[list(balls)].max())
    offered = sorted((ball for ball in balls if ball != first), key=lambda ball: -distances[ball])
    for ball in offered:
        if distances[ball] >= MIN_SPAN_SHARE * farthest and approach.is_safe_however_turned(first, ball):
            third = choose_third_ball(centres, balls, (first, ball))
            return LocatingBalls(first, ball, third)
    raise DataError(
        "the artefact cannot be located safely: the probe could hit it at every second ball if it were turned",
        hint="place it so that two balls far apart are near its top, or use a longer stylus (probe.stem_length_mm)",
    )


class _Approach:
    """Artefact in its nominal position and the probe above it. Heights are measured against the stylus direction."""

    def __init__(self, layout: MeasuringLayout, position: Position) -> None:
        self._artefact = layout.artefact_at(position.station)
        self._up: Array = -layout.frame.stylus_axis
        self._deepest_mm = layout.contact_mm - layout.approach_mm
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        self._pose = mount_pose(layout.location(position.station), layout.mount, azimuth, elevation)
        self._bodies = artefact_bodies(self._artefact, self._pose)
        self._probe = tuple(body for body in layout.probe.bodies(layout.frame) if body.name not in _MOVING_WITH_TIP)
        self.centres = self._pose.apply(self._artefact.balls)
        self.top_mm = max(self._extent(body.shape)[1] for body in self._bodies)
        self._above_tip_mm = min(self._extent(body.shape)[0] for body in self._probe)

    def height_mm(self, ball: int) -> float:
        return float(self.centres[ball] @ self._up)

    def off_centre_mm(self, ball: int) -> float:
        return float(np.linalg.norm(self.centres[ball] - self.centres.mean(axis=0)))

    def is_high(self, ball: int) -> bool:
        """Return True if the other parts of the probe stay above the whole artefact while the tip searches `ball`."""
        lowest_mm = self.height_mm(ball) + self._deepest_mm + self._above_tip_mm
        return lowest_mm >= self.top_mm + CLEARANCE_MM

    def is_safe_however_turned(self, first: int, ball: int) -> bool:
        """Return True if the other parts of the probe stay clear of the artefact on their way to `ball`, if the
        artefact is turned by any angle about the vertical through the ball found as `first`. That may be any ball that
        is as high as `first`."""
        if self.is_high(ball):
            return True
        end = self.centres[ball] + self._deepest_mm * self._up
        start = end + max(self.top_mm - float(end @ self._up), 0.0) * self._up
        # The first descent finds any ball of about this height, so each of them may be the one that was found.
        mistaken = [one for one in range(len(self.centres)) if self._as_high(one, first)]
        return not any(
            Scene(self._probe, self._turned(turn_deg, one, first)).first_hit(
                point(start), point(end), clearance_mm=CLEARANCE_MM
            )
            for one in mistaken
            for turn_deg in np.arange(0.0, 360.0, _TURN_DEG).tolist()
        )

    def _as_high(self, one: int, first: int) -> bool:
        return abs(self.height_mm(one) - self.height_mm(first)) <= EQUALLY_HIGH_MM

    def _turned(self, turn_deg: float, one: int, first: int) -> tuple[Body, ...]:
        """Return the bodies of the artefact, turned and shifted so that the ball `one` is where `first` belongs."""
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        centre = self.centres[first] + turn @ (self._pose.centre - self.centres[one])
        return artefact_bodies(self._artefact, Pose(centre, turn @ self._pose.rotation))

    def _extent(self, shape: Shape) -> tuple[float, float]:
        ends = sorted((float(np.dot(shape.lower, self._up)), float(np.dot(shape.upper, self._up))))
        return ends[0], ends[1]
