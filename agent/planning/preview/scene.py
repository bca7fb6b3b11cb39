"""Contents of a preview as immutable values. This module neither draws nor uses files.

Lengths are in mm, in the workpiece frame. The path is that of the centre of the stylus tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.artefact.position_set import Position
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Point


@dataclass(frozen=True)
class PreviewBall:
    """Ball of a preview.

    `obstruction` is the reason why the probe cannot measure the ball; it is empty if the ball can be measured.
    """

    number: int
    centre_mm: Point
    obstruction: str

    @property
    def reachable(self) -> bool:
        return not self.obstruction


@dataclass(frozen=True)
class ArtefactPlacement:
    """Artefact in one position, with the mount that holds it.

    `bodies` contains the balls, posts and bar of the artefact, the shaft and pedestal of the mount, and all other
    stationary bodies except the table.
    """

    position: Position
    held_out: bool
    balls: tuple[PreviewBall, ...]
    bodies: tuple[Body, ...]

    @property
    def reachable(self) -> int:
        return sum(ball.reachable for ball in self.balls)


@dataclass(frozen=True)
class Visit:
    """One measurement of a position, or a position that is not measured.

    `placement` is the index of the placement of the artefact in this position. The waypoints of the visit have the
    indices from `first` to `end` in the path; `end` is exclusive. `note` is the reason why the position is not
    measured; it is empty if the position is measured.
    """

    phase: str
    placement: int
    first: int
    end: int
    note: str = ""


@dataclass(frozen=True)
class PathPoint:
    """Point of the path, reached at the end of a step.

    `ends_s` is the time in s at which the tip reaches the point. `ball` is the number of the ball that is being
    measured, or None. `touch` is True if the step is a touch.
    """

    tip_mm: Point
    ends_s: float
    ball: int | None
    touch: bool


@dataclass(frozen=True)
class Refusal:
    """Refusal of a plan by the preflight.

    `message` is the text of the refusal, and `step` is the key of the refused step. `bodies` contains the names of the
    two colliding bodies; it is empty if they are not known. `tip_mm` is the tip centre at the collision. `visit` is the
    index of the visit to which the step belongs.
    """

    message: str
    step: str
    bodies: tuple[str, ...]
    tip_mm: Point
    visit: int


@dataclass(frozen=True)
class Preview:
    """Preview of a plan.

    `travel` is the box in which the tip centre can move, and `table` is the drawn part of the table. `probe` contains
    the bodies of the probe, with coordinates relative to the tip centre.
    """

    machine: str
    artefact: str
    position_set: str
    travel: Box
    table: Box
    probe: tuple[Body, ...]
    placements: tuple[ArtefactPlacement, ...]
    visits: tuple[Visit, ...]
    path: tuple[PathPoint, ...]
    refusal: Refusal | None

    @property
    def balls(self) -> int:
        return sum(len(placement.balls) for placement in self.placements)

    @property
    def unreachable(self) -> int:
        return self.balls - sum(placement.reachable for placement in self.placements)

    @property
    def minutes(self) -> float:
        """Machine time of the whole path in minutes.

        If the plan was refused, the path ends at the refusal.
        """
        return self.path[-1].ends_s / 60.0 if self.path else 0.0

    @property
    def stations(self) -> Sequence[int]:
        return sorted({placement.position.station for placement in self.placements})
