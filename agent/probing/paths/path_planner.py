"""Takes the tip where the next touch begins and out again: what a plan needs to know of ways.

`PlainPathPlanner` withdraws from every ball, and to the retreat plane between positions; the planner in
`agent.probing.paths.shortest_path` goes the fastest way that is proved to be free.
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
    """Where the next position is: what a pilot reads of a position's task."""

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
    """Of one plan, from the retreat plane to the retreat plane; between positions it may stay nearer."""

    def sequence(self, task: PlannedPosition) -> tuple[int, list[int], int]:
        """The ball to begin and end with, those in between in the order of measuring, and the other end."""
        ...

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        """Go where the artefact may turn, and turn it. `here` (3,): where the machine stands."""
        ...

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        """Before the first ball, once the artefact stands still."""
        ...

    def align(self, centres_mm: Array) -> None:
        """From now on all balls (N, 3) are known to be there."""
        ...

    def to_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def way_at(self, ball: int) -> TouchPath: ...

    def from_ball(self, key: str, centre: Array) -> Plan[None]: ...

    def beside(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        """Take over before a `ball` found at `centre` (3,), the tip in the plane before it."""
        ...

    def leave(self, key: str, centre: Array) -> Plan[None]:
        """To the retreat plane, or beside the station; `centre` (3,) of the ball measured last."""
        ...


class PlainPathPlanner:
    """Back by `retract_mm` from every ball; to the retreat plane and beside the station between positions."""

    def __init__(self, course: Retreat, probing: ProbingParameters) -> None:
        self._course = course
        self._probing = probing

    def sequence(self, task: PlannedPosition) -> tuple[int, list[int], int]:
        first, *between, last = task.balls
        return first, between[::-1], last

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        course = self._course
        yield MoveTo(f"{task.key}/retreat", point(course.retreated(here)))
        yield MoveTo(f"{task.key}/park", point(course.parked(here, task.station)))
        yield OrientTo(f"{task.key}/orient", task.station, task.azimuth_deg, task.elevation_deg)

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        above = self._course.above(task.predicted_mm[ball], self._probing)
        yield MoveTo(f"{task.key}/enter", point(self._course.retreated(above)))

    def align(self, centres_mm: Array) -> None:
        """Whatever is known of the pose, the ways stay the same."""

    def to_ball(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(f"{key}/approach", point(self._course.above(centre, self._probing)))

    def way_at(self, ball: int) -> TouchPath:
        return PlainTouchPath(self._probing)

    def from_ball(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(f"{key}/withdraw", point(self._course.above(centre, self._probing)))

    def beside(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        yield from ()

    def leave(self, key: str, centre: Array) -> Plan[None]:
        yield MoveTo(f"{key}/leave", point(self._course.retreated(self._course.above(centre, self._probing))))
