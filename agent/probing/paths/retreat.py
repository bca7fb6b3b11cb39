"""Where it is safe to be: the way between positions that needs no proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.probing.paths.free_paths import FreePathRules
from agent.probing.probing_parameters import ProbingParameters
from twin.arrays import Array


@dataclass(frozen=True)
class Retreat:
    """Where it is safe to be, and how to get about.

    `retreat_axis` is the axis the stylus points along, `retreat_mm` the axis position on it that no part of
    artefact or mount reaches; `park_mm` the X position at each station's mount, clear of the turning artefact.
    `roads` lead to the shortest free ways; None: retract and retreat as far as `above` and `parked` say.
    """

    retreat_axis: int
    retreat_mm: float
    station_axis: int
    park_mm: Mapping[int, float]
    roads: FreePathRules | None = None

    def retreated(self, position: Array) -> Array:
        out = position.copy()
        out[self.retreat_axis] = self.retreat_mm
        return out

    def above(self, centre: Array, probing: ProbingParameters) -> Array:
        """Where the tip clears the balls beside: back from a ball along the stylus, inside the travel."""
        out = centre - probing.stylus_axis * (probing.contact_mm + probing.retract_mm)
        towards = np.sign(probing.stylus_axis[self.retreat_axis])
        out[self.retreat_axis] = towards * max(towards * out[self.retreat_axis], towards * self.retreat_mm)
        return out

    def parked(self, position: Array, station: int) -> Array:
        out = self.retreated(position)
        out[self.station_axis] = self.park_mm[station]
        return out
