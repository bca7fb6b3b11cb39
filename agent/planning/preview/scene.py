"""Contents of the preview of a plan as immutable values. This module neither draws nor uses files.

Lengths are in mm, and points are in the workpiece frame. The path of the preview is that of the centre of the stylus
tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.artefact.position_set import Position
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Point
from twin.collision.probe_frame import ProbeFrame


@dataclass(frozen=True)
class PreviewBall:
    """Ball of the artefact as the preview shows it in one position.

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
    """Artefact in one position (station and orientation), with the mount that holds it.

    `bodies` contains the balls, posts and bar or frame of the artefact, the shaft and pedestal of the mount, and all
    other stationary bodies except the machine table. `held_out` is True if the position is measured only for
    verification.
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
    """One measurement of all balls of a position, or a position that is not measured.

    `placement` is the index of the position in `Preview.placements`. The points of the path that belong to the visit
    have the indices from `first` to `end` in `Preview.path`; `end` is exclusive. `note` is the reason why the position
    is not measured; it is empty if the position is measured.
    """

    phase: str
    placement: int
    first: int
    end: int
    note: str = ""


@dataclass(frozen=True)
class PathPoint:
    """Point of the path of the stylus tip, reached at the end of a step.

    `ends_s` is the time in s, from the start of the plan, at which the tip reaches the point. `ball` is the number of
    the ball that is being measured, or None. `touch` is True if the step is a touch.
    """

    tip_mm: Point
    ends_s: float
    ball: int | None
    touch: bool


@dataclass(frozen=True)
class Refusal:
    """Refusal of a plan by the preflight, the simulated execution of the plan.

    `message` is the text of the refusal, and `step` is the key of the refused step. `bodies` contains the names of the
    two colliding bodies; it is empty if they are not known. `tip_mm` is the tip centre at the collision. `visit` is the
    index in `Preview.visits` of the visit to which the step belongs.
    """

    message: str
    step: str
    bodies: tuple[str, ...]
    tip_mm: Point
    visit: int


@dataclass(frozen=True)
class Preview:
    """Preview of a plan: the placements of the artefact, the visits to them, and the path of the stylus tip.

    `travel` is the box in which the tip centre can move, and `table` is the drawn part of the machine table. `probe`
    contains the bodies of the probe, with coordinates relative to the tip centre. `frame` gives the direction of the
    stylus.
    """

    machine: str
    artefact: str
    position_set: str
    travel: Box
    table: Box
    frame: ProbeFrame
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
        """Machine time of the whole path of the stylus tip in minutes.

        If the preflight refused the plan, the path ends at the refused step.
        """
        return self.path[-1].ends_s / 60.0 if self.path else 0.0

    @property
    def stations(self) -> Sequence[int]:
        return sorted({placement.position.station for placement in self.placements})
