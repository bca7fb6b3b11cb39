"""Section of an estimate file with the knowledge about errors that drift in one direction over the nights."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from twin.arrays import Array
from twin.errors import FormatError
from twin.formats.stored_arrays import lower_triangle, stored_array, symmetric_matrix
from twin.formats.toml_reading import StrictModel
from twin.identification.drift_trend import DriftRates, DriftStart, DriftTrend
from twin.identification.unknowns import Unknowns

_DIGITS = 6  # of the sums of a test; 16 would double the file

Row = tuple[float, ...]
Rows = tuple[Row, ...]


class DriftStartSection(StrictModel):
    """Sums of the nights since one first night of a drift. The entries have the meanings of the fields of
    `twin.identification.drift_trend.DriftStart`; only the lower triangle of `information` is stored."""

    measured: int = Field(ge=1)
    nights: float = Field(gt=0.0)
    effect: Rows
    score: Row
    information: Rows


class DriftRatesSection(StrictModel):
    """Rates of the errors that drift. `parameters` contains the names of the drifting parameters; the other entries
    have the meanings of the fields of `twin.identification.drift_trend.DriftRates`. Only the lower triangle of
    `covariance` is stored."""

    parameters: tuple[str, ...]
    mean: Row
    covariance: Rows
    cross: Rows
    nights: float = Field(gt=0.0)
    false_alarm: float = Field(ge=0.0, le=1.0)


class DriftTrendSection(StrictModel):
    """Knowledge about errors that drift in one direction: `starts` for a drift that has not been found yet, and the
    `rates` of one that has; null if there is none."""

    starts: tuple[DriftStartSection, ...] = ()
    rates: DriftRatesSection | None = None


def trend_document(trend: DriftTrend, unknowns: Unknowns) -> dict[str, Any]:
    """Return the section of an estimate file with `trend` as a JSON object."""
    rates, names = trend.rates, unknowns.model.names
    return {
        "starts": [
            {
                "measured": start.measured,
                "nights": start.nights,
                "effect": _short(start.effect).tolist(),
                "score": _short(start.score).tolist(),
                "information": lower_triangle(_short(start.information)),
            }
            for start in trend.starts
        ],
        "rates": None
        if rates is None
        else {
            "parameters": [names[column] for column in rates.columns],
            "mean": rates.mean.tolist(),
            "covariance": lower_triangle(rates.covariance),
            "cross": rates.cross.tolist(),
            "nights": rates.nights,
            "false_alarm": rates.false_alarm,
        },
    }


def read_trend(section: DriftTrendSection, unknowns: Unknowns, source: str, key: str) -> DriftTrend:
    """Return the knowledge that the section `section` under `key` of an estimate file describes. Raise FormatError,
    which names `source` and the key, if its sizes or names do not match `unknowns`."""
    size, parameters = unknowns.blocks.size, unknowns.model.size
    starts = tuple(
        DriftStart(
            start.measured,
            start.nights,
            stored_array(start.effect, (size, parameters), source, f"{key}.starts.{number}.effect"),
            stored_array(start.score, (parameters,), source, f"{key}.starts.{number}.score"),
            symmetric_matrix(start.information, parameters, source, f"{key}.starts.{number}.information"),
        )
        for number, start in enumerate(section.starts)
    )
    return DriftTrend(
        starts, None if section.rates is None else _rates(section.rates, unknowns, source, f"{key}.rates")
    )


def _rates(section: DriftRatesSection, unknowns: Unknowns, source: str, key: str) -> DriftRates:
    names, count = unknowns.model.names, len(section.parameters)
    unknown = [name for name in section.parameters if name not in names]
    if unknown or not count:
        raise FormatError("the model has no such parameter", file=source, key=f"{key}.parameters")
    return DriftRates(
        np.array([names.index(name) for name in section.parameters], dtype=np.int64),
        stored_array(section.mean, (count,), source, f"{key}.mean"),
        symmetric_matrix(section.covariance, count, source, f"{key}.covariance"),
        stored_array(section.cross, (unknowns.blocks.size, count), source, f"{key}.cross"),
        section.nights,
        section.false_alarm,
    )


def _short(values: Array) -> Array:
    """Return the values with few enough digits to keep the file small."""
    with np.errstate(divide="ignore"):
        places = np.where(values == 0.0, 0.0, _DIGITS - 1 - np.floor(np.log10(np.abs(values))))
    unit = 10.0 ** np.clip(places, -300.0, 300.0)
    return np.asarray(np.round(values * unit) / unit)
