"""Data frames of the values of the library, for readers who have pandas installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import singledispatch
from importlib import import_module
from typing import Any

import numpy as np

from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import StoredEstimate
from twin.identification import Estimate
from twin.units import MICRO_UNITS, UM_PER_MM
from volcal.estimation import Prediction
from volcal.position_design import Design
from volcal.simulation import Simulation

Columns = Mapping[str, Sequence[Any] | np.ndarray[Any, Any]]
AXIS_NAMES = ("x", "y", "z")


def frame(value: object) -> Any:
    """Return a pandas data frame with one row for each ball centre of a `BallFile` or a `Simulation`, each parameter of
    an estimate, each point of a `Prediction`, each node of a `CompensationTable`, or each position of a `Design`.

    Column names end with their units. Raises DataError if pandas is not installed or if there is no frame for the type
    of `value`.
    """
    found = columns(value)
    try:
        pandas = import_module("pandas")
    except ImportError:
        raise DataError("a data frame needs pandas", hint="Install it: pip install pandas") from None
    return pandas.DataFrame(dict(found))


@singledispatch
def columns(value: object) -> Columns:
    """Return the columns of the data frame of a value, by name. Raises DataError if there is none for its type.

    >>> list(columns(volcal.evaluate(setup, "S1")))
    ['station', 'azimuth_deg', 'elevation_deg']
    """
    known = "BallFile, Simulation, Estimate, StoredEstimate, Prediction, CompensationTable, Design"
    raise DataError(f"there is no data frame of a {type(value).__name__}", hint=f"One of {known}")


@columns.register
def _balls(balls: BallFile) -> Columns:
    seen = balls.observations
    numbers = np.array(balls.numbers or range(len(balls.positions)))
    station = np.array([position.station for position in balls.positions])
    azimuth = np.array([position.azimuth_deg for position in balls.positions])
    elevation = np.array([position.elevation_deg for position in balls.positions])
    return {
        "position": numbers[seen.position],
        "station": station[seen.position],
        "azimuth_deg": azimuth[seen.position],
        "elevation_deg": elevation[seen.position],
        "ball": seen.ball,
        **{f"{axis}_mm": seen.axis_positions[:, index] for index, axis in enumerate(AXIS_NAMES)},
        **{
            f"sigma_{axis}_um": UM_PER_MM * np.sqrt(seen.covariance[:, index, index])
            for index, axis in enumerate(AXIS_NAMES)
        },
        "temperature_c": seen.temperature_c,
    }


@columns.register
def _simulation(simulation: Simulation) -> Columns:
    return _balls(simulation.balls)


@columns.register(Estimate)
@columns.register(StoredEstimate)
def _estimate(estimate: Estimate | StoredEstimate) -> Columns:
    parameters = estimate.model.parameters
    units = [MICRO_UNITS[one.unit] for one in parameters]
    factors = np.array([factor for _, factor in units])
    return {
        "name": [one.name for one in parameters],
        "error": [one.error for one in parameters],
        "order": [one.order for one in parameters],
        "unit": [name for name, _ in units],
        "value": factors * estimate.parameters,
        "standard_uncertainty": factors * np.sqrt(np.diagonal(estimate.covariance)),
    }


@columns.register
def _prediction(prediction: Prediction) -> Columns:
    sigma = prediction.standard_uncertainty_mm
    return {
        **{f"{axis}_mm": prediction.points_mm[:, index] for index, axis in enumerate(AXIS_NAMES)},
        **{f"error_{axis}_um": UM_PER_MM * prediction.error_mm[:, index] for index, axis in enumerate(AXIS_NAMES)},
        **{f"standard_uncertainty_{axis}_um": UM_PER_MM * sigma[:, index] for index, axis in enumerate(AXIS_NAMES)},
    }


@columns.register
def _compensation_table(table: CompensationTable) -> Columns:
    nodes = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    corrections = UM_PER_MM * table.corrections.reshape(-1, 3)
    return {
        **{f"{axis}_mm": nodes[:, index] for index, axis in enumerate(AXIS_NAMES)},
        **{f"correction_{axis}_um": corrections[:, index] for index, axis in enumerate(AXIS_NAMES)},
        "measured": ~table.extrapolated.reshape(-1),
    }


@columns.register
def _design(found: Design) -> Columns:
    return {
        "station": [position.station for position in found.positions],
        "azimuth_deg": [position.azimuth_deg for position in found.positions],
        "elevation_deg": [position.elevation_deg for position in found.positions],
    }
