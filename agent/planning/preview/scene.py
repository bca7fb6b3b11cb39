"""What a preview shows, as frozen values: no drawing, no files.

Lengths in mm, in the workpiece frame; the path is that of the stylus tip's centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.artefact.position_set import Position
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Point


@dataclass(frozen=True)
class PreviewBall:
    """`why_not`: what keeps the probe from it; empty where it can be reached."""

    number: int
    centre_mm: Point
    why_not: str

    @property
    def reachable(self) -> bool:
        return not self.why_not


@dataclass(frozen=True)
class ArtefactPlacement:
    """The artefact in one position, with the mount that holds it. `bodies`: balls, posts, bar, shaft, pedestal."""

    position: Position
    held_out: bool
    balls: tuple[PreviewBall, ...]
    bodies: tuple[Body, ...]

    @property
    def reachable(self) -> int:
        return sum(ball.reachable for ball in self.balls)


@dataclass(frozen=True)
class Visit:
    """One time that a position is measured: waypoints `first` to `end` (exclusive) of the path.

    `note`: why nothing is measured there, for a visit without waypoints.
    """

    phase: str
    placing: int
    first: int
    end: int
    note: str = ""


@dataclass(frozen=True)
class PathPoint:
    """`ball`: whose measurement it belongs to; `touch`: the tip is on a ball."""

    tip_mm: Point
    ends_s: float
    ball: int | None
    touch: bool


@dataclass(frozen=True)
class Refusal:
    """Why preflight said no: at which step, which two bodies, and where the tip then is."""

    message: str
    step: str
    bodies: tuple[str, ...]
    tip_mm: Point
    visit: int


@dataclass(frozen=True)
class Preview:
    """`travel`: where the tip can be; `table`: the part of it under the travel; `probe`: relative to the tip."""

    machine: str
    artefact: str
    position_set: str
    travel: Box
    table: Box
    probe: tuple[Body, ...]
    placings: tuple[ArtefactPlacement, ...]
    visits: tuple[Visit, ...]
    path: tuple[PathPoint, ...]
    refusal: Refusal | None

    @property
    def balls(self) -> int:
        return sum(len(placing.balls) for placing in self.placings)

    @property
    def unreachable(self) -> int:
        return self.balls - sum(placing.reachable for placing in self.placings)

    @property
    def minutes(self) -> float:
        """Machine time of the whole path; of a refused plan, until it is refused."""
        return self.path[-1].ends_s / 60.0 if self.path else 0.0

    @property
    def stations(self) -> Sequence[int]:
        return sorted({placing.position.station for placing in self.placings})
