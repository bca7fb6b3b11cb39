"""Contents of a preview as immutable values, without drawing or files.

Lengths are in mm, in the workpiece frame. The path is that of the stylus tip's centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.artefact.position_set import Position
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Point


@dataclass(frozen=True)
class PreviewBall:
    """Ball of a preview. `obstruction`: reason why the probe cannot measure it; empty if it can."""

    number: int
    centre_mm: Point
    obstruction: str

    @property
    def reachable(self) -> bool:
        return not self.obstruction


@dataclass(frozen=True)
class ArtefactPlacement:
    """Artefact in one position, with the mount that holds it. `bodies`: balls, posts, bar, shaft and pedestal, and
    other stationary bodies except the table."""

    position: Position
    held_out: bool
    balls: tuple[PreviewBall, ...]
    bodies: tuple[Body, ...]

    @property
    def reachable(self) -> int:
        return sum(ball.reachable for ball in self.balls)


@dataclass(frozen=True)
class Visit:
    """One measurement of a position, or a position not measured. `placement`: index of the position's placement;
    `first`, `end` (exclusive): range of its waypoints in the path.

    `note` is the reason why the position is not measured; it is empty if the position is measured.
    """

    phase: str
    placement: int
    first: int
    end: int
    note: str = ""


@dataclass(frozen=True)
class PathPoint:
    """Point of the path. `ends_s` is the time at which the tip reaches the point. `ball` is the number of the ball
    being measured. `touch` is True if the step is a touch."""

    tip_mm: Point
    ends_s: float
    ball: int | None
    touch: bool


@dataclass(frozen=True)
class Refusal:
    """Refusal by the preflight: message, step, names of the two colliding bodies, and tip centre at the collision.
    `visit`: index of the visit to which the step belongs."""

    message: str
    step: str
    bodies: tuple[str, ...]
    tip_mm: Point
    visit: int


@dataclass(frozen=True)
class Preview:
    """Preview of a plan. `travel` is the travel of the tip, and `table` the drawn part of the table. `probe` has the
    bodies of the probe, relative to the tip centre."""

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
        """Machine time in minutes of the whole path. If the plan was refused, the path ends at the refusal."""
        return self.path[-1].ends_s / 60.0 if self.path else 0.0

    @property
    def stations(self) -> Sequence[int]:
        return sorted({placement.position.station for placement in self.placements})
