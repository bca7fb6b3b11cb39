"""Interface of path planners, which move the tip to the start of the next touch and away from the ball.

`PlainPathPlanner` withdraws from every ball, and moves to the retreat plane between positions. The planner in
`agent.probing.paths.shortest_path` takes the fastest path that is proved free.
"""

from __future__ import annotations

from typing import Protocol

from agent.execution.steps import MoveTo, OrientTo, Plan
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import PlainTouchPath, TouchPath, point
from twin.arrays import Array
from twin.artefact.position_set import Position


class PlannedPosition(Protocol):
    """Properties of the next position to measure that a path planner needs."""

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
    """Path planner of one plan. A plan starts and ends at the retreat plane. Between two positions, the tip may stay
    closer to the artefact."""

    def sequence(self, task: PlannedPosition) -> tuple[int, list[int], int]:
        """Return the end ball measured first and again last, the balls between the ends in measuring order, and the
        other end ball."""
        ...

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        """Move the tip clear of the turning artefact, then turn it. `here` (3,): current axis positions."""
        ...

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        """Move in front of `ball`, the first one, after the artefact has turned."""
        ...

    def align(self, centres_mm: Array) -> None:
        """Use these centres (N, 3) of all balls from now on."""
        ...

    def to_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def touch_path(self, ball: int) -> TouchPath: ...

    def from_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def take_over(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        """Start planning paths from the plane in front of `ball`, where the tip is. The ball was found at `centre`
        (3,)."""
        ...

    def leave(self, key: str, centre: Array) -> Plan[None]:
        """Move to the retreat plane or to the park location. `centre` (3,): centre of the ball measured last."""
        ...


class PlainPathPlanner:
    """Planner that withdraws by `retract_mm` from every ball, and moves between positions by way of the retreat plane
    and the park location."""

    def __init__(self, retreat: Retreat, probing: ProbingParameters) -> None:
        self._retreat = retreat
        self._probing = probing

    def sequence(self, task: PlannedPosition) -> tuple[int, list[int], int]:
        first, *between, last = task.balls
        return first, between[::-1], last

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        retreat = self._retreat
        yield MoveTo(f"{task.key}/retreat", point(retreat.at_retreat_plane(here)))
        yield MoveTo(f"{task.key}/park", point(retreat.park_location(here, task.station)))
        yield OrientTo(f"{task.key}/orient", task.station, task.azimuth_deg, task.elevation_deg)

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        above = self._retreat.withdrawn_from(task.predicted_mm[ball], self._probing)
        yield MoveTo(f"{task.key}/enter", point(self._retreat.at_retreat_plane(above)))

    def align(self, centres_mm: Array) -> None:
        """Do nothing: plain paths do not depend on the pose."""

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
