"""Retreat plane and park locations: safe paths between positions that need no proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.probing.paths.free_paths import FreePathRules
from agent.probing.probing_parameters import ProbingParameters
from twin.arrays import Array


@dataclass(frozen=True)
class Retreat:
    """Locations that are safe, and the rules for paths between them.

    `retreat_axis` is the axis the stylus points along, `retreat_mm` the axis position on it that no part of
    artefact or mount reaches; `park_mm` the X position at each station's mount, clear of the turning artefact.
    `path_rules`: rules for free paths; None: plain paths by way of `withdrawn_from` and `park_location`.
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
        """Return the axis positions (3,) withdrawn from a ball along the stylus, within the travel, clear of others."""
        out = centre - probing.stylus_axis * (probing.contact_mm + probing.retract_mm)
        towards = np.sign(probing.stylus_axis[self.retreat_axis])
        out[self.retreat_axis] = towards * max(towards * out[self.retreat_axis], towards * self.retreat_mm)
        return out

    def park_location(self, position: Array, station: int) -> Array:
        out = self.at_retreat_plane(position)
        out[self.station_axis] = self.park_mm[station]
        return out
