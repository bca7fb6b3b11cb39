"""A ball that a plan touches, in plain arithmetic: no world, no field, only a sphere and what is wrong with a touch."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.execution import steps as s
from drivers.errors import VolcalError
from drivers.roles import Miss, Orientation, Touch

Late = Callable[[np.ndarray, float, str], float | None]
"""(direction of travel, feed, key) → mm of travel from contact to trip; None: the touch does not trip at all."""


class TouchedBall:
    """Plays the steps of a plan. `steps` and `events` are what it was asked for."""

    def __init__(self, centre_mm: np.ndarray, contact_mm: float, late: Late) -> None:
        self.centre_mm = centre_mm
        self.contact_mm = contact_mm
        self.late = late
        self.at = np.zeros(3)
        self.steps: list[s.Step] = []

    def run(self, plan: s.Plan[Any]) -> Any:
        """The plan's conclusion; its own errors travel on."""
        result: Any = None
        try:
            while True:
                step = plan.send(result)
                self.steps.append(step)
                result = self.to(step)
        except StopIteration as stop:
            return stop.value

    def to(self, step: s.Step) -> Any:
        match step:
            case s.MoveTo():
                self.at = np.array(step.target_mm)
            case s.TouchTowards():
                return self.touch(step)
            case s.ReadPosition():
                return tuple(self.at.tolist())
            case s.OrientTo():
                return Orientation(step.azimuth_deg, step.elevation_deg)
        return None

    def touch(self, step: s.TouchTowards) -> Touch | Miss:
        target = np.array(step.target_mm)
        way = target - self.at
        length = float(np.linalg.norm(way))
        way = way / length
        contact = entry_mm(self.at - self.centre_mm, way, self.contact_mm)
        late = self.late(way, step.feed_mm_per_s, step.key)
        if contact is None or late is None or contact + late > length:
            self.at = target
            return Miss(step.target_mm)
        self.at = self.at + way * (contact + late)
        x, y, z = self.at.tolist()
        return Touch((x, y, z))

    @property
    def events(self) -> list[dict[str, Any]]:
        return [dict(x.payload) for x in self.steps if isinstance(x, s.Record) and x.kind == "event"]

    @property
    def touched(self) -> list[str]:
        return [x.key for x in self.steps if isinstance(x, s.TouchTowards)]


def entry_mm(offset: np.ndarray, way: np.ndarray, radius: float) -> float | None:
    """Return the distance to a sphere along a ray from `offset`: the smaller root of |offset + t·way| = radius."""
    along = sum(float(o) * float(w) for o, w in zip(offset, way, strict=True))
    missed_by = sum(float(o) ** 2 for o in offset) - along**2
    if missed_by >= radius**2:
        return None
    return -along - math.sqrt(radius**2 - missed_by)


def ended(player: TouchedBall, plan: s.Plan[Any]) -> tuple[Any, str]:
    """Conclusion and how it ended."""
    try:
        return player.run(plan), "done"
    except VolcalError as error:
        return None, str(error)
