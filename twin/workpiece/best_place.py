"""Search for the place on the table at which a workpiece gets the smallest errors.

The criterion of a place is the largest share of its tolerance that any feature may use up, with an error at the end of
its 95 % interval: 1 at a limit, and more beyond it. Without tolerances it is the largest error itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.error_model import Ranges
from twin.units import UM_PER_MM
from twin.workpiece.features import Feature
from twin.workpiece.machine_field import MachineKnowledge
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import FeatureError, predict_features

_LEAST_SCALE_MM = 1e-3  # for a single limit at or near 0, which has no width


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """Criterion of a workpiece at the places `x_mm` (m,) and `y_mm` (n,) of its origin on the table.

    `criterion` (m, n) is a share of the tolerance if `of_tolerance` is True, otherwise µm. `turned_rad` and the height
    `z_mm` of the origin are the same for all places. `best` are the indices of the smallest value.
    """

    x_mm: Array
    y_mm: Array
    z_mm: float
    turned_rad: float
    criterion: Array
    of_tolerance: bool

    @property
    def best(self) -> tuple[int, int]:
        i, j = np.unravel_index(int(np.argmin(self.criterion)), self.criterion.shape)
        return int(i), int(j)

    @property
    def best_placement(self) -> Placement:
        """Placement with the smallest criterion."""
        i, j = self.best
        return Placement(np.array([self.x_mm[i], self.y_mm[j], self.z_mm]), self.turned_rad)


def place_map(
    estimate: MachineKnowledge,
    features: Sequence[Feature],
    placement: Placement,
    tool_offset: Array,
    table: CompensationTable | None = None,
    counts: tuple[int, int] = (15, 9),
) -> PlaceMap:
    """Return the criterion at `counts` places of the origin that cover, along X and Y, all places at which the whole
    workpiece can be reached. Height and turn are those of `placement`. With a table, the errors with the table count.

    Raises DataError if the workpiece cannot be reached at any place.
    """
    x, y = _reachable(features, placement, tool_offset, estimate.model.ranges_mm, counts)
    z_mm = float(placement.origin_mm[2])
    of_tolerance = any(feature.tolerance is not None for feature in features)
    criterion = np.empty((len(x), len(y)))
    for i, j in np.ndindex(criterion.shape):
        place = replace(placement, origin_mm=np.array([x[i], y[j], z_mm]))
        predicted = predict_features(estimate, features, place, tool_offset, table)
        criterion[i, j] = max(
            _used(one.feature, one.with_table or one.without_table, of_tolerance) for one in predicted
        )
    return PlaceMap(x, y, z_mm, placement.turned_rad, criterion, of_tolerance)


def _used(feature: Feature, error: FeatureError, of_tolerance: bool) -> float:
    if not of_tolerance:
        return UM_PER_MM * max(abs(error.low_mm), abs(error.high_mm))
    limits = feature.tolerance
    if limits is None:
        return 0.0
    scale_mm = max(limits.half_width_mm, _LEAST_SCALE_MM)
    beyond = [] if limits.upper_mm is None else [error.high_mm - limits.upper_mm]
    short = [] if limits.lower_mm is None else [limits.lower_mm - error.low_mm]
    return 1.0 + max(*beyond, *short, -np.inf) / scale_mm


def _reachable(
    features: Sequence[Feature], placement: Placement, tool_offset: Array, ranges_mm: Ranges, counts: tuple[int, int]
) -> tuple[Array, Array]:
    points = np.concatenate([feature.points for feature in features])
    at = replace(placement, origin_mm=placement.origin_mm * [0.0, 0.0, 1.0]).in_machine(points) - tool_offset
    places = []
    for axis, count in enumerate(counts):
        low, high = ranges_mm[axis]
        first, last = low - at[:, axis].min(), high - at[:, axis].max()
        if first > last:
            size = float(np.ptp(at[:, axis]))
            raise DataError(
                f"the workpiece needs {size:.1f} mm along {'XY'[axis]}, but the machine was identified over "
                f"{high - low:g} mm",
                hint="Turn the workpiece",
            )
        places.append(np.linspace(first, last, count))
    x, y = places
    return x, y
