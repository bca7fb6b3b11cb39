"""Measured ball centres of a run, and their conversion into the observations of an identification."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.probing.ball import FittedBall
from agent.thermal.machine_drift import RunDrift
from agent.thermal.readings import Conditions
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.collision.measuring_layout import MeasuringLayout
from twin.thermal.readings import smooth_readings

Correction = Callable[[Array], Array]
"""Function from displayed axis positions (n, 3) in mm to the corrections (n, 3) in mm that the controller adds."""


@dataclass(frozen=True)
class MeasuredBall:
    """Measured ball centre, with the position and the temperatures at which it was measured."""

    position: int
    station: int
    azimuth_deg: float
    elevation_deg: float
    ball: int
    found: FittedBall
    conditions: Conditions

    @property
    def temperature_c(self) -> float:
        """Temperature of the artefact in °C."""
        return self.conditions.artefact_c

    def record(self, key: str) -> dict[str, object]:
        return {
            "key": key,
            "position": self.position,
            "station": self.station,
            "azimuth_deg": self.azimuth_deg,
            "elevation_deg": self.elevation_deg,
            "ball": self.ball,
            "centre_mm": self.found.centre_mm,
            "covariance_mm2": self.found.covariance_mm2,
            "radius_mm": _known(self.found.radius_mm),
            "form_mm": _known(self.found.form_mm),
            "temperature_c": self.temperature_c,
            "machine_c": self.conditions.machine_c,
            "instant_s": self.conditions.instant_s,
        }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def observations_of(
    balls: Sequence[MeasuredBall],
    tool_offset_mm: Array,
    correction: Correction,
    drift: RunDrift | None = None,
) -> Observations:
    """Return the observations (measured ball centres with their temperatures) of the machine without compensation.
    Their axis positions are the displayed positions plus the corrections of the active table.

    `correction` maps n displayed axis positions (n, 3) in mm to the corrections (n, 3) in mm that the controller adds.
    `drift` is the drift of the machine while the balls were measured, or None if it is not estimated. With a drift, the
    observations contain its regressors and smoothed temperatures of the artefact.
    """
    temperature_c = np.array([ball.temperature_c for ball in balls])
    displayed = np.array([ball.found.centre_mm for ball in balls])
    return Observations(
        position=np.array(_renumbered(ball.position for ball in balls)),
        ball=np.array([ball.ball for ball in balls]),
        tool=np.zeros(len(balls), dtype=np.int64),
        axis_positions=displayed + correction(displayed),
        covariance=np.array([ball.found.covariance_mm2 for ball in balls]),
        temperature_c=temperature_c if drift is None else smooth_readings(drift.instants_s, temperature_c),
        elevation_rad=np.array([math.radians(ball.elevation_deg) for ball in balls]),
        azimuth_rad=np.array([math.radians(ball.azimuth_deg) for ball in balls]),
        tool_offsets=tool_offset_mm.reshape(1, 3),
        thermal_regressors=np.zeros((len(balls), 0)) if drift is None else drift.regressors,
    )


def numbered_together(balls: Iterable[MeasuredBall], layout: MeasuringLayout) -> list[MeasuredBall]:
    """Return the balls with the numbers that observations use: those of all stations together, if each station has an
    artefact of its own."""
    return [replace(ball, ball=ball.ball + layout.first_ball(ball.station)) for ball in balls]


def no_correction(displayed: Array) -> Array:
    return np.zeros_like(displayed)


def position_numbers(balls: Iterable[MeasuredBall]) -> list[int]:
    """Return the number in the run of each position of the observations of `balls`."""
    return list(dict.fromkeys(ball.position for ball in balls))


def _renumbered(numbers: Iterable[int]) -> list[int]:
    """Return an index for each position number, counted from 0 in the order of first occurrence."""
    seen: dict[int, int] = {}
    return [seen.setdefault(number, len(seen)) for number in numbers]
