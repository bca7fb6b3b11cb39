"""Contents of a preview as immutable values, without drawing or files.

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
    """Ball of a preview. `obstruction`: reason why the probe cannot measure it; empty if it can."""

    number: int
    centre_mm: Point
    obstruction: str

    @property
    def reachable(self) -> bool:
        return not self.obstruction


@dataclass(frozen=True)
class ArtefactPlacement:
    """Artefact in one position, with the mount that holds it. `bodies`: balls, posts, bar, shaft, pedestal."""

    position: Position
    held_out: bool
    balls: tuple[PreviewBall, ...]
    bodies: tuple[Body, ...]

    @property
    def reachable(self) -> int:
        return sum(ball.reachable for ball in self.balls)


@dataclass(frozen=True)
class Visit:
    """One measurement of a position: waypoints `first` to `end` (exclusive) of the path.

    `note`: reason why a position without waypoints is not measured.
    """

    phase: str
    placement: int
    first: int
    end: int
    note: str = ""


@dataclass(frozen=True)
class PathPoint:
    """Point of the path. `ball`: ball being measured; `touch`: the tip is on a ball."""

    tip_mm: Point
    ends_s: float
    ball: int | None
    touch: bool


@dataclass(frozen=True)
class Refusal:
    """Refusal by the preflight: message, step, the two colliding bodies and the tip centre there."""

    message: str
    step: str
    bodies: tuple[str, ...]
    tip_mm: Point
    visit: int


@dataclass(frozen=True)
class Preview:
    """Preview of a plan. `travel`: that of the tip; `table`: its part under the travel; `probe`: relative to the
    tip."""

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
        """Machine time of the whole path; for a refused plan, up to the refusal."""
        return self.path[-1].ends_s / 60.0 if self.path else 0.0

    @property
    def stations(self) -> Sequence[int]:
        return sorted({placement.position.station for placement in self.placements})
