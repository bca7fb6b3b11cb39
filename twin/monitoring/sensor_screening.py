"""Sensors whose readings can be used to explain a drift: those that vary, have few gaps, and neither stick nor jump.

The rules are those of a person who looks at the readings: a sensor that gives exactly the same value through several
runs while others change is stuck; a reading far from both neighbours in time, which agree with each other, is a jump; a
level that changes by more than a machine hall can and never returns is a sensor that has come off. They judge what
cannot be right, not what is unusual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array
from twin.errors import DataError

STUCK_NIGHTS = 3
"""Number of consecutive nights with exactly the same reading from which a sensor is stuck."""
JUMP_K = 8.0
"""Change in K against the other nights, beyond that of the other sensors, that no sensor of a machine makes."""
LEAST_SHARE = 0.8
"""Share of the nights in which a sensor must have a usable reading."""
LEAST_RANGE_SIGMAS = 4.0
"""Smallest range of the readings, in standard uncertainties of a reading, of a sensor that varies."""
LOWEST_C, HIGHEST_C = -30.0, 90.0
"""Range in °C of the readings of a sensor of a machine; others are no readings."""
_UNCHANGED_K = 1e-9


def plausible_readings(readings_c: Mapping[str, float]) -> dict[str, float]:
    """Return those of the readings in °C by sensor that a sensor of a machine can give."""
    return {sensor: float(value) for sensor, value in readings_c.items() if LOWEST_C <= value <= HIGHEST_C}


@dataclass(frozen=True)
class SensorVerdict:
    """Verdict on a sensor: the reason why its readings cannot be used, which is empty if they can.

    `left_out` is the number of nights whose reading is not used: missing, stuck, or a jump.
    """

    name: str
    reason: str
    left_out: int

    @property
    def usable(self) -> bool:
        return not self.reason


@dataclass(frozen=True, eq=False)
class ScreenedSensors:
    """Readings in °C (n, s) of s sensors in n nights, NaN where a reading is missing or not used, with the verdict on
    each sensor."""

    readings_c: Array
    verdicts: tuple[SensorVerdict, ...]

    @property
    def usable(self) -> tuple[int, ...]:
        """Indices of the sensors that can be used."""
        return tuple(place for place, one in enumerate(self.verdicts) if one.usable)


def screen_sensors(names: Sequence[str], readings_c: ArrayLike, uncertainties_k: ArrayLike) -> ScreenedSensors:
    """Judge the readings (n, s) in °C of s sensors in n nights, in the order of time; NaN stands for no reading.

    `uncertainties_k` (n, s) contains their standard uncertainties in K. Raises DataError if the shapes differ.
    """
    readings = np.array(readings_c, dtype=np.float64)
    sigmas = np.asarray(uncertainties_k, dtype=np.float64)
    if readings.ndim != 2 or readings.shape[1] != len(names) or sigmas.shape != readings.shape:
        raise DataError(f"readings and uncertainties must have one column for each of {len(names)} sensors")
    readings[~np.isfinite(readings) | (readings < LOWEST_C) | (readings > HIGHEST_C)] = np.nan
    notes = ["" for _ in names]
    given = readings.copy()
    for place in range(len(names)):
        others = np.delete(given, place, axis=1)
        notes[place] = _remove_stuck(readings, place, others) or _remove_jumps(readings, place, others)
    verdicts = [
        _verdict(name, readings[:, place], sigmas[:, place], note)
        for place, (name, note) in enumerate(zip(names, notes, strict=True))
    ]
    return ScreenedSensors(readings, tuple(verdicts))


def _remove_stuck(readings: Array, place: int, others: Array) -> str:
    """Remove the readings of a stuck sensor; return what was found if it is still stuck in the last night."""
    column = readings[:, place]
    known = np.flatnonzero(np.isfinite(column))
    first = 0
    found = ""
    for end in range(1, len(known) + 1):
        if end < len(known) and abs(column[known[end]] - column[known[first]]) <= _UNCHANGED_K:
            continue
        nights = known[first:end]
        if len(nights) >= STUCK_NIGHTS and _others_moved(others, nights):
            found = f"stuck at {column[nights[0]]:.2f} °C for {len(nights)} nights" if end == len(known) else ""
            readings[nights[1:], place] = np.nan
        first = end
    return found


def _others_moved(others: Array, nights: NDArray[np.intp]) -> bool:
    """Return True if another sensor changed in these nights, or if there is no other one that could tell."""
    spans = [np.ptp(column[np.isfinite(column)]) for column in others[nights].T if np.isfinite(column).any()]
    return not spans or max(spans) > _UNCHANGED_K


def _remove_jumps(readings: Array, place: int, others: Array) -> str:
    """Remove single readings that jump there and back; return what was found if a sensor jumped and stayed there.

    A jump is judged against the median change of the other sensors, so that a hall that cools down over a shutdown is
    none.
    """
    column = readings[:, place]
    known = np.flatnonzero(np.isfinite(column))
    if len(known) < STUCK_NIGHTS:
        return ""
    values = column[known] - _common(others)[known]
    changes = np.diff(values)
    alone = [
        at
        for at in range(1, len(known) - 1)
        if abs(changes[at - 1]) > JUMP_K and abs(changes[at]) > JUMP_K and changes[at - 1] * changes[at] < 0.0
    ]
    readings[known[alone], place] = np.nan
    values = np.delete(values, alone)
    largest = float(np.abs(np.diff(values)).max(initial=0.0))
    return f"jumped by {largest:.1f} K against the other sensors and stayed there" if largest > JUMP_K else ""


def _common(others: Array) -> Array:
    """Return the median of the other sensors in each night (n,), 0 where there is none."""
    found = np.zeros(len(others))
    for night, row in enumerate(others):
        known = row[np.isfinite(row)]
        found[night] = np.median(known) if known.size else 0.0
    return found


def _verdict(name: str, column: Array, sigmas: Array, note: str) -> SensorVerdict:
    known = np.isfinite(column)
    left_out = int((~known).sum())
    if note:
        return SensorVerdict(name, note, left_out)
    if known.sum() < LEAST_SHARE * len(column):
        return SensorVerdict(name, f"usable readings in only {int(known.sum())} of {len(column)} nights", left_out)
    span_k, sigma_k = float(np.ptp(column[known])), float(np.median(sigmas[known]))
    if span_k <= LEAST_RANGE_SIGMAS * sigma_k:
        text = f"constant: it varies by {span_k:.2f} K, not more than {LEAST_RANGE_SIGMAS:g} times its uncertainty"
        return SensorVerdict(name, text, left_out)
    return SensorVerdict(name, "", left_out)
