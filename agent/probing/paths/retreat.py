"""Retreat plane and park locations beside the stations. Paths by way of this plane and these locations are safe between
positions without a collision check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.probing.paths.free_paths import FreePathRules
from agent.probing.probing_parameters import ProbingParameters
from twin.arrays import Array


@dataclass(frozen=True)
class Retreat:
    """Safe locations between positions, and the rules for the paths between them.

    `retreat_axis` is the index of the axis along which the stylus points. `retreat_mm` is the end of travel of this
    axis from which the stylus points towards the artefact; no part of the artefact or mount reaches it. `station_axis`
    is the index of the axis along which the stations stand. `park_mm` maps each station to the position of that axis at
    which the probe is clear of the turning artefact. `path_rules` are the rules for collision-free paths; they are None
    if plain paths by way of the places given by the methods `withdrawn_from` and `park_location` are used.
    """

    retreat_axis: int
    retreat_mm: float
    station_axis: int
    park_mm: Mapping[int, float]
    path_rules: FreePathRules | None = None

    @property
    def side_axis(self) -> int:
        """Index of the axis that is perpendicular to the stylus and to the station axis."""
        return 3 - self.retreat_axis - self.station_axis

    def at_retreat_plane(self, position: Array) -> Array:
        out = position.copy()
        out[self.retreat_axis] = self.retreat_mm
        return out

    def withdrawn_from(self, centre: Array, probing: ProbingParameters) -> Array:
        """Return the axis positions (3,) of the tip after it has been withdrawn along the stylus by
        `probing.retract_mm` from contact with the ball at `centre`. The tip is never withdrawn beyond the retreat plane
        (`retreat_mm`)."""
        out = centre - probing.stylus_axis * (probing.contact_mm + probing.retract_mm)
        towards = np.sign(probing.stylus_axis[self.retreat_axis])
        out[self.retreat_axis] = towards * max(towards * out[self.retreat_axis], towards * self.retreat_mm)
        return out

    def park_location(self, position: Array, station: int) -> Array:
        out = self.at_retreat_plane(position)
        out[self.station_axis] = self.park_mm[station]
        return out
