"""Path planner for an artefact that is placed by hand. Between two balls it raises the tip above the whole artefact.

The artefact stands only approximately where it was to be placed. Paths that lead past its parts would have to be
computed anew for each placement; a path above all of them is free wherever it stands.
"""

from __future__ import annotations

import numpy as np

from agent.execution.steps import MoveTo, Plan
from agent.probing.paths.path_planner import PlainPathPlanner, PlannedPosition
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import point
from twin.arrays import Array

RAISED_MM = 20.0
"""Distance of the tip above the highest part of the artefact while it moves from ball to ball."""


class RaisedPathPlanner(PlainPathPlanner):
    """Path planner that moves the tip from ball to ball in a plane above the artefact.

    `top_mm` is the axis position, along the stylus, at which the centre of the tip is at the highest part of the
    artefact.
    """

    def __init__(self, retreat: Retreat, probing: ProbingParameters, top_mm: float) -> None:
        super().__init__(retreat, probing)
        up = -float(probing.stylus_axis[retreat.retreat_axis])
        raised = top_mm + up * (probing.tip_radius_mm + RAISED_MM)
        self._raised_mm = up * min(up * raised, up * retreat.retreat_mm)

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        """Do nothing, because a person has placed the artefact."""
        yield from ()

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        """Do nothing, because every path to a ball begins above the artefact."""
        yield from ()

    def to_ball(self, key: str, centre: Array) -> Plan[None]:
        above = self._retreat.withdrawn_from(centre, self._probing)
        yield MoveTo(f"{key}/across", point(self._above(above)))
        yield MoveTo(f"{key}/approach", point(above))

    def from_ball(self, key: str, centre: Array) -> Plan[None]:
        above = self._retreat.withdrawn_from(centre, self._probing)
        yield MoveTo(f"{key}/withdraw", point(above))
        yield MoveTo(f"{key}/raise", point(self._above(above)))

    def _above(self, position: Array) -> Array:
        """Return `position` (3,) in the plane above the artefact, or where it is, if that is still higher."""
        out, axis = position.copy(), self._retreat.retreat_axis
        up = -np.sign(self._probing.stylus_axis[axis])
        out[axis] = up * max(up * out[axis], up * self._raised_mm)
        return np.asarray(out)
