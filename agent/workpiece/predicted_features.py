"""Predicted errors of the features of a workpiece, from an estimate, a table and a feature file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import read_text, translated
from agent.printable import no_formula
from agent.workpiece.estimate_and_table import EstimateAndTable, read_estimate_and_table
from twin.arrays import Array
from twin.units import UM_PER_MM
from twin.workpiece.best_place import PlaceMap, place_map
from twin.workpiece.feature_file import parse_features
from twin.workpiece.placement import Placement
from twin.workpiece.prediction import FeatureError, FeaturePrediction, predict_features

RULE = "ISO 14253-1:2017, conformance probability limit 97.5 %"


@dataclass(frozen=True)
class WantedPlace:
    """Place of a workpiece. `origin_mm` is the place of its origin in the coordinates of the machine, for the tip of
    the tool, and None for the best place on the table; its height is then `height_mm`. If `with_map` is True, the
    errors at other places are computed as well.
    """

    origin_mm: tuple[float, float, float] | None
    height_mm: float
    turned_rad: float
    with_map: bool


@dataclass(frozen=True)
class PredictionRequest:
    """Files and place of a prediction. For the files other than `features`, and for `tool_offset_mm`, see
    `read_estimate_and_table`."""

    features: Path
    estimate: Path
    table: Path | None
    without_table: bool
    tool_offset_mm: tuple[float, float, float] | None
    place: WantedPlace


@dataclass(frozen=True, eq=False)
class PredictedFeatures:
    """Predicted errors of the features at `placement`. `table` is the name of the table, as a rule its file, and None
    without one. `places` contains the errors at other places, if they were wanted."""

    predictions: tuple[FeaturePrediction, ...]
    placement: Placement
    tool_offset_mm: Array
    table: str | None
    places: PlaceMap | None

    def as_json(self) -> dict[str, Any]:
        """Return the prediction as a JSON object, with errors in µm."""
        return {
            "rule": RULE,
            "origin_mm": self.placement.origin_mm.tolist(),
            "turned_deg": degrees(self.placement.turned_rad),
            "tool_offset_mm": self.tool_offset_mm.tolist(),
            "table": self.table,
            "features": [
                {
                    "name": one.feature.name,
                    "kind": one.feature.kind.value,
                    "lower_um": _um(None if one.feature.tolerance is None else one.feature.tolerance.lower_mm),
                    "upper_um": _um(None if one.feature.tolerance is None else one.feature.tolerance.upper_mm),
                    "without_table": error_document(one.without_table),
                    "with_table": None if one.with_table is None else error_document(one.with_table),
                }
                for one in self.predictions
            ],
            "places": None if self.places is None else _places_document(self.places),
        }


def predict_file(request: PredictionRequest) -> PredictedFeatures:
    """Return the predicted errors of the features in a file.

    Raises InputError, which names the file and the row, column or key, if a file is invalid, or if the workpiece cannot
    be reached where it stands.
    """
    known = read_estimate_and_table(request.estimate, request.table, request.without_table, request.tool_offset_mm)
    return predict_text(read_text(request.features), str(request.features), known, request.place)


def predict_text(text: str, file: str, known: EstimateAndTable, place: WantedPlace) -> PredictedFeatures:
    """Return the predicted errors of the features in the text of the file named `file`.

    Raises InputError, which names the file and the row and column, if the text is invalid, or if the workpiece cannot
    be reached where it stands.
    """
    estimate, table, offset = known.estimate, known.table, known.tool_offset_mm
    with translated(file=file):
        features = parse_features(text, file)
        placement = Placement(np.array(place.origin_mm or (0.0, 0.0, place.height_mm)), place.turned_rad)
        places = None
        if place.with_map or place.origin_mm is None:
            places = place_map(estimate, features, placement, offset, table)
        if place.origin_mm is None and places is not None:
            placement = places.best_placement
        predictions = predict_features(estimate, features, placement, offset, table)
    return PredictedFeatures(predictions, placement, offset, known.table_name, places)


def error_document(error: FeatureError) -> dict[str, Any]:
    """Return a predicted error as a JSON object, in µm."""
    return {
        "expected_um": _um(error.expected_mm),
        "expanded_um": _um(error.expanded_mm),
        "low_um": _um(error.low_mm),
        "high_um": _um(error.high_mm),
        "conformity": error.conformity.value,
    }


def csv_lines(predictions: tuple[FeaturePrediction, ...]) -> Iterator[list[str]]:
    """Yield the header and the rows of a CSV file with the predictions, in µm.

    A name that a spreadsheet would take for a formula has an apostrophe in front.
    """
    columns = ("expected_um", "expanded_um", "low_um", "high_um", "conformity")
    yield ["name", "kind", *(f"{column}_{state}" for state in ("without_table", "with_table") for column in columns)]
    for one in predictions:
        cells = [no_formula(one.feature.name), one.feature.kind.value]
        for error in (one.without_table, one.with_table):
            document = {} if error is None else error_document(error)
            cells += [str(document.get(column, "")) for column in columns]
        yield cells


def _um(value_mm: float | None) -> float | None:
    return None if value_mm is None else round(UM_PER_MM * value_mm, 4)


def _places_document(places: PlaceMap) -> dict[str, Any]:
    return {
        "x_mm": places.x_mm.tolist(),
        "y_mm": places.y_mm.tolist(),
        "z_mm": places.z_mm,
        "unit": "share of the tolerance" if places.of_tolerance else "µm",
        "largest": places.criterion.tolist(),
        "best_mm": places.best_placement.origin_mm.tolist(),
    }
