"""Interface of path planners. A path planner moves the tip to the start of the next touch and away from the ball.

`PlainPathPlanner` withdraws the tip from every ball, and moves it between positions to the retreat plane, which no part
of the artefact or mount reaches. The planner in `agent.probing.paths.shortest_path` takes the fastest path that is
proved free of collisions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from agent.execution.steps import MoveTo, OrientTo, Plan
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import PlainTouchPath, TouchPath, point
from twin.arrays import Array
from twin.artefact.pose_alignment import choose_alignment_balls
from twin.artefact.position_set import Position


@dataclass(frozen=True)
class MeasuringSequence:
    """Measuring order of the balls of one position.

    The end balls `first` and `last` are measured first. On an artefact whose balls are not close to one line, the ball
    `third` follows; it is None on a bar. These balls determine the pose of the artefact. The balls `others` follow in
    the given order, and `first` is measured once more at the end.
    """

    first: int
    last: int
    third: int | None
    others: list[int]


class PlannedPosition(Protocol):
    """Properties that a path planner needs to know about the next position to measure."""

    @property
    def key(self) -> str: ...
    @property
    def station(self) -> int: ...
    @property
    def azimuth_deg(self) -> float: ...
    @property
    def elevation_deg(self) -> float: ...
    @property
    def predicted_mm(self) -> Array: ...
    @property
    def balls(self) -> list[int]: ...


class PathPlanner(Protocol):
    """Interface of the path planner that one measuring plan uses. A plan starts and ends at the retreat plane, which no
    part of the artefact or mount reaches. Between two positions, the tip may stay closer to the artefact."""

    def sequence(self, task: PlannedPosition) -> MeasuringSequence:
        """Return the measuring order of the balls of `task`, the next position to measure."""
        ...

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        """Move the tip clear of the artefact, then turn the artefact to the azimuth and elevation of `task`, the next
        position to measure. `here` (3,) holds the present axis positions."""
        ...

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        """Move the tip in front of `ball` after the artefact has been turned. `ball` is the ball that is measured
        first."""
        ...

    def align(self, centres_mm: Array) -> None:
        """Use `centres_mm` (N, 3) as the expected centres of all N balls from now on."""
        ...

    def to_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def touch_path(self, ball: int) -> TouchPath: ...

    def from_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def take_over(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        """Start planning from the present place of the tip, which is in front of `ball`, in a plane perpendicular to
        the stylus. `centre` (3,) holds the axis positions at which the ball was found."""
        ...

    def leave(self, key: str, centre: Array) -> Plan[None]:
        """Move the tip to the retreat plane, which no part of the artefact or mount reaches, or to a park location
        beside the artefact's station, where the probe is clear of the turning artefact. `centre` (3,) is the centre of
        the ball that was measured last."""
        ...


class PlainPathPlanner:
    """Path planner that withdraws the tip by `retract_mm` from every ball. Between positions, it moves the tip to the
    retreat plane, which no part of the artefact or mount reaches, and to a park location beside the artefact's station,
    where the probe is clear of the turning artefact."""

    def __init__(self, retreat: Retreat, probing: ProbingParameters) -> None:
        self._retreat = retreat
        self._probing = probing

    def sequence(self, task: PlannedPosition) -> MeasuringSequence:
        chosen = choose_alignment_balls(task.predicted_mm, task.balls)
        others = [ball for ball in reversed(task.balls) if ball not in (*chosen.ends, chosen.third)]
        return MeasuringSequence(*chosen.ends, chosen.third, others)

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        retreat = self._retreat
        yield MoveTo(f"{task.key}/retreat", point(retreat.at_retreat_plane(here)))
        yield MoveTo(f"{task.key}/park", point(retreat.park_location(here, task.station)))
        yield OrientTo(f"{task.key}/orient", task.station, task.azimuth_deg, task.elevation_deg)

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        above = self._retreat.withdrawn_from(task.predicted_mm[ball], self._probing)
        yield MoveTo(f"{task.key}/enter", point(self._retreat.at_retreat_plane(above)))

    def align(self, centres_mm: Array) -> None:
        """Do nothing, because plain paths do not depend on the pose of the artefact."""

    def to_ball(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(f"{key}/approach", point(self._retreat.withdrawn_from(centre, self._probing)))

    def touch_path(self, ball: int) -> TouchPath:
        return PlainTouchPath(self._probing)

    def from_ball(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(f"{key}/withdraw", point(self._retreat.withdrawn_from(centre, self._probing)))

    def take_over(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        yield from ()

    def leave(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(
            f"{key}/leave", point(self._retreat.at_retreat_plane(self._retreat.withdrawn_from(centre, self._probing)))
        )
