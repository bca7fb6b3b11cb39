"""Predicted errors of the features of a workpiece."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from twin.arrays import as_vector
from twin.compensation.table import CompensationTable
from twin.workpiece.best_place import PlaceMap
from twin.workpiece.best_place import place_map as map_places
from twin.workpiece.feature_file import parse_features
from twin.workpiece.features import Feature
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import FeaturePrediction
from twin.workpiece.prediction import predict_features as predict_at
from volcal.estimation import AnyEstimate, tool_offset
from volcal.files import PathName, text_of


def read_features(path: PathName) -> tuple[Feature, ...]:
    """Return the features of a workpiece that a feature file (CSV) contains: points, distances, diameters, positions of
    holes and flatness of faces, with their tolerances.

    Raises FormatError, which names file, row and column, if the file is invalid.

    >>> features = volcal.read_features(volcal.shipped_file("examples/bearing-plate.csv"))
    >>> [feature.name for feature in features if feature.kind == "diameter"]
    ['bearing seat']
    """
    return parse_features(text_of(path), str(path))


def predict_features(
    estimate: AnyEstimate,
    features: Sequence[Feature],
    origin_mm: ArrayLike,
    *,
    turned_rad: float = 0.0,
    table: CompensationTable | None = None,
    tool_offset_mm: ArrayLike | None = None,
) -> tuple[FeaturePrediction, ...]:
    """Predict the errors of features of a workpiece, with their uncertainty, and what may be said about their
    tolerances.

    The origin of the workpiece is at `origin_mm`, shape (3,), in the coordinates of the machine, for the tip of the
    tool. The workpiece is turned by `turned_rad` about Z. If `table` is given, the errors are also predicted with this
    table. For the tool offset, see `predict`. Raises DataError if a feature cannot be reached, or if the datum points
    do not set the coordinate system of the workpiece.

    >>> table = volcal.compensation_table(estimate, balls)
    >>> seat = volcal.predict_features(estimate, features, [1000.0, 500.0, 400.0], table=table)[2]
    >>> seat.feature.name, str(seat.with_table.conformity)
    ('bearing seat', 'conforms')
    """
    placement = Placement(as_vector(origin_mm, 3, "origin of the workpiece"), turned_rad)
    return predict_at(estimate, features, placement, tool_offset(estimate, tool_offset_mm), table)


def place_map(
    estimate: AnyEstimate,
    features: Sequence[Feature],
    z_mm: float,
    *,
    turned_rad: float = 0.0,
    table: CompensationTable | None = None,
    tool_offset_mm: ArrayLike | None = None,
    counts: tuple[int, int] = (15, 9),
) -> PlaceMap:
    """Return the largest error of a workpiece, as a share of its tolerance, at places of its origin all over the table.

    The origin is at the height `z_mm`. The property `best_placement` of the result is the place with the smallest
    value. `counts` contains the numbers of places along X and Y. Raises DataError if the workpiece cannot be reached at
    any place.

    >>> places = volcal.place_map(estimate, features, 400.0, counts=(3, 2))
    >>> places.criterion.shape, places.of_tolerance
    ((3, 2), True)
    """
    placement = Placement(as_vector([0.0, 0.0, z_mm], 3, "height"), turned_rad)
    return map_places(estimate, features, placement, tool_offset(estimate, tool_offset_mm), table, counts)
