"""Retreat plane and park locations, which give safe paths between positions without a collision check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.probing.paths.free_paths import FreePathRules
from agent.probing.probing_parameters import ProbingParameters
from twin.arrays import Array


@dataclass(frozen=True)
class Retreat:
    """Safe locations, and the rules for paths between them.

    `retreat_axis`: index of the axis along which the stylus points. `retreat_mm`: position of this axis that no part of
    artefact or mount reaches. `station_axis`: index of the axis along which the stations stand. `park_mm`: station →
    position of that axis at which the probe is clear of the turning artefact. `path_rules`: rules for free paths; None
    for plain paths by way of `withdrawn_from` and `park_location`.
    """

    retreat_axis: int
    retreat_mm: float
    station_axis: int
    park_mm: Mapping[int, float]
    path_rules: FreePathRules | None = None

    def at_retreat_plane(self, position: Array) -> Array:
        out = position.copy()
        out[self.retreat_axis] = self.retreat_mm
        return out

    def withdrawn_from(self, centre: Array, probing: ProbingParameters) -> Array:
        """Return the axis positions (3,) withdrawn along the stylus from the ball at `centre`, at most to the retreat
        plane."""
        out = centre - probing.stylus_axis * (probing.contact_mm + probing.retract_mm)
        towards = np.sign(probing.stylus_axis[self.retreat_axis])
        out[self.retreat_axis] = towards * max(towards * out[self.retreat_axis], towards * self.retreat_mm)
        return out

    def park_location(self, position: Array, station: int) -> Array:
        out = self.at_retreat_plane(position)
        out[self.station_axis] = self.park_mm[station]
        return out
