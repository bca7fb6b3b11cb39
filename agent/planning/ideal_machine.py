"""Ideal machine for timing a plan. It executes each step at once and reports the time that the step would take.

The ideal machine uses neither simulated physics nor a device. It provides the function that carries out each type of
step, as the engine needs it. The plans of a run can therefore be timed without change.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from agent.execution import steps as s
from agent.execution.engine import Action
from agent.planning.stand_ins import MemoryStore, stand_in_answers
from agent.planning.time_model import TimeModel
from drivers.roles import Miss, Orientation, PlacementRequest, Touch
from twin.artefact.position_set import Position
from twin.collision.geometry import Point, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.motion_law import StraightPath, entry_distance, straight_path


class IdealMachine:
    """Ideal machine for timing a plan. Its axes start at the axis positions `start_mm`.

    A mount that serves all stations starts with both angles zero. If every station has its own mount, each mount starts
    at the angles of its first turn, which therefore takes no motion time. The balls are at their nominal locations in
    `layout`, and the probe trips at contact.

    `spent(step, motion_s, overhead_s)` is called for every step that takes time, with the time of the motion and the
    additional time, such as the latency of the command, both in s.
    """

    def __init__(
        self, layout: MeasuringLayout, model: TimeModel, start_mm: Point, spent: Callable[[s.Step, float, float], None]
    ) -> None:
        self._layout = layout
        self._model = model
        self._spent = spent
        self._at_mm = start_mm
        self._turned_deg: dict[int, tuple[float, float]] = {}
        self._balls: list[Point] = []

    def actions(self) -> dict[type, Action]:
        """Return a mapping from each type of step of a measuring plan to the function that carries it out on the ideal
        machine.
        """
        return {
            s.MoveTo: self._move,
            s.TouchTowards: self._touch,
            s.OrientTo: self._orient,
            s.ReadTemperatures: lambda _: {"artefact": self._layout.artefact.reference_temperature_c},
            s.ReadClock: lambda _: 0.0,
            s.ReadPosition: lambda _: self._at_mm,
            s.CheckPermissions: lambda _: None,
            s.CheckProbe: lambda _: None,
            s.AskOperator: self._ask,
            s.Record: lambda _: None,
            s.ResetFault: lambda _: None,
            **MemoryStore().actions(),
            **stand_in_answers(),
        }

    def _move(self, step: s.MoveTo) -> None:
        self._took(step, self._model.move_s(self._at_mm, step.target_mm, step.feed_mm_per_s))
        self._at_mm = step.target_mm

    def _touch(self, step: s.TouchTowards) -> Touch | Miss:
        path = straight_path(self._at_mm, step.target_mm)
        trip_mm = self._contact(path)
        motion_s, self._at_mm = self._model.touch_s(path, step.feed_mm_per_s, trip_mm)
        self._took(step, motion_s)
        return Miss(self._at_mm) if trip_mm is None else Touch(path.at(trip_mm))

    def _orient(self, step: s.OrientTo) -> Orientation:
        target_deg = (step.azimuth_deg, step.elevation_deg)
        own_mounts = bool(self._layout.neighbours)
        mount = step.station if own_mounts else 0
        before_deg = self._turned_deg.get(mount, target_deg if own_mounts else (0.0, 0.0))
        self._took(step, self._model.turn_s(before_deg, target_deg))
        self._turned_deg[mount] = target_deg
        self._set_balls(Position(step.station, step.azimuth_deg, step.elevation_deg))
        return Orientation(*target_deg)

    def _ask(self, step: s.AskOperator) -> None:
        self._took(step, 0.0)
        request = step.request
        if isinstance(request, PlacementRequest) and request.station is not None:
            self._set_balls(Position(request.station, request.azimuth_deg, request.elevation_deg))

    def _set_balls(self, position: Position) -> None:
        self._balls = [point(ball) for ball in self._layout.nominal(position)]

    def _contact(self, path: StraightPath) -> float | None:
        """Return the distance in mm along `path` at which the tip first touches a ball; None if it touches no ball."""
        reach, first = self._layout.contact_mm, math.inf
        for ball in self._balls:
            distance = entry_distance(path.start, path, ball, reach)
            if distance is not None and distance < first:
                first = distance
        return first if first < math.inf else None

    def _took(self, step: s.Step, motion_s: float) -> None:
        self._spent(step, motion_s, self._model.overhead_s(step))
