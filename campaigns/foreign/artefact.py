"""Ball artefacts that differ from their certificate, and what a machine measures on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from campaigns.foreign.machine import HIGH, LOW, TOOL, DrawnMachine
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import with_uncertified
from twin.artefact.observations import Observations

STATIONS_MM = ((560.0, 900.0, 750.0), (1520.0, 900.0, 750.0), (2480.0, 900.0, 750.0), (3440.0, 900.0, 750.0))
DIAGONAL_DEG = math.degrees(math.atan(math.sqrt(0.5)))
S1 = ((0.0, 0.0), (90.0, 0.0), (0.0, 90.0))
S2 = ((45.0, DIAGONAL_DEG), (-45.0, DIAGONAL_DEG), (45.0, -DIAGONAL_DEG), (-45.0, -DIAGONAL_DEG))
S3 = ((45.0, 0.0), (-45.0, 0.0), (0.0, 45.0), (0.0, -45.0), (90.0, 45.0), (90.0, -45.0))
CTE_PER_K, CTE_UNCERTAINTY_PER_K = 11.5e-6, 0.3e-6
CERTIFICATE_MM, NOISE_MM = 0.8e-3, 1e-3
_MARGIN_MM = 10.0


@dataclass(frozen=True)
class ForeignBar:
    """Certified and true ball centres (N, 3) in mm at 20 °C, and the true CTE in 1/K. The balls `uncertified` have no
    certificate."""

    certified: np.ndarray
    true: np.ndarray
    cte_per_k: float
    uncertified: tuple[int, ...] = ()

    @property
    def artefact(self) -> Artefact:
        """The certificate as the program reads it."""
        return Artefact(
            name="foreign",
            certificate="drawn",
            balls=self.certified,
            ball_diameter_mm=25.0,
            reference_temperature_c=20.0,
            cte_per_k=CTE_PER_K,
            cte_standard_uncertainty_per_k=CTE_UNCERTAINTY_PER_K,
            covariance=with_uncertified(np.eye(self.certified.size) * CERTIFICATE_MM**2, self.uncertified),
            holder_length_mm=60.0,
            uncertified=self.uncertified,
        )


def tilted_bar(rng: np.random.Generator, balls: int = 11) -> ForeignBar:
    """Draw a bar whose balls stand alternately up to 16 mm off its axis."""
    nominal = np.zeros((balls, 3))
    nominal[:, 0] = np.linspace(-750.0, 750.0, balls)
    turn = 0.5 * np.pi * np.arange(balls)
    nominal[:, 1], nominal[:, 2] = -60.0 - 15.5 * np.sin(turn), 15.5 * np.cos(turn)
    return _drawn(nominal + rng.normal(0.0, 0.03, nominal.shape), rng)


def straight_bar(rng: np.random.Generator, off_axis_mm: float, balls: int = 11) -> ForeignBar:
    """Draw a bar whose balls stand on one line within a standard deviation of `off_axis_mm`."""
    nominal = np.zeros((balls, 3))
    nominal[:, 0] = np.linspace(-750.0, 750.0, balls) + rng.normal(0.0, 0.05, balls)
    nominal[:, 1:] = rng.normal(0.0, off_axis_mm, (balls, 2))
    nominal[:, 1] -= 60.0
    return _drawn(nominal, rng)


def _drawn(certified: np.ndarray, rng: np.random.Generator) -> ForeignBar:
    true = certified + rng.normal(0.0, CERTIFICATE_MM, certified.shape)
    return ForeignBar(certified, true, CTE_PER_K + rng.normal(0.0, CTE_UNCERTAINTY_PER_K))


@dataclass(frozen=True)
class Measured:
    """Observations and the true roll (K,) in rad of the bar in each position, from the mount's nominal one."""

    seen: Observations
    roll_rad: np.ndarray


def measure(
    machine: DrawnMachine,
    bar: ForeignBar,
    orientations: Sequence[tuple[float, float]],
    rng: np.random.Generator,
    *,
    clamping_roll_rad: float | None = None,
    hall_c: float = 20.0,
    thermometer_error_k: float = 0.0,
    stations: Sequence[Sequence[float]] = STATIONS_MM,
) -> Measured:
    """Measure the bar at each station in each orientation (azimuth, elevation) in degrees, as `measure_at` does."""
    places = [(station, orientations) for station in stations]
    conditions = MeasuringConditions(clamping_roll_rad, hall_c, thermometer_error_k)
    return measure_at(machine, bar, places, rng, conditions)


@dataclass(frozen=True)
class MeasuringConditions:
    """MeasuringConditions of a measurement: the roll of the bar in its clamp, drawn at each station if it is None, the
    temperature of the hall in °C, and the error of the thermometer in K."""

    clamping_roll_rad: float | None = None
    hall_c: float = 20.0
    thermometer_error_k: float = 0.0


def measure_at(
    machine: DrawnMachine,
    bar: ForeignBar,
    places: Sequence[tuple[Sequence[float], Sequence[tuple[float, float]]]],
    rng: np.random.Generator,
    conditions: MeasuringConditions = MeasuringConditions(),
) -> Measured:
    """Measure the bar at each of `places`: a station (3,) in mm, and its orientations (azimuth, elevation) in degrees.

    The mount misses every angle by some tenths of a degree and every place by some millimetres. The bar is within 0.8 K
    of the temperature of the hall.
    """
    rows: list[tuple[float, ...]] = []
    rolls: list[float] = []
    for station, orientations in places:
        given = conditions.clamping_roll_rad
        clamped = rng.uniform(-np.pi, np.pi) if given is None else given
        for azimuth_deg, elevation_deg in orientations:
            number = len(rolls)
            roll = clamped + rng.normal(0.0, 0.005)
            azimuth, elevation = np.radians([azimuth_deg, elevation_deg]) + rng.normal(0.0, 0.003, 2)
            temperature = conditions.hall_c + 0.8 * math.sin(0.2 * number)
            grown = bar.true * (1.0 + bar.cte_per_k * (temperature - 20.0))
            place = np.array(station) + rng.normal(0.0, 2.0, 3)
            points = place + grown @ turned_bar(azimuth, elevation, roll).T
            found = machine.axis_positions_at(points)
            inside = ((found > LOW + _MARGIN_MM) & (found < HIGH - _MARGIN_MM)).all(axis=1)
            for ball in np.flatnonzero(inside).tolist():
                touched = found[ball] + rng.normal(0.0, NOISE_MM, 3)
                read = temperature + conditions.thermometer_error_k
                rows.append((number, ball, *np.radians([azimuth_deg, elevation_deg]), read, *touched))
            rolls.append(roll)
    table = np.array(rows)
    n = len(table)
    seen = Observations(
        position=table[:, 0].astype(int),
        ball=table[:, 1].astype(int),
        tool=np.zeros(n, dtype=int),
        axis_positions=table[:, 5:],
        covariance=np.tile(np.eye(3) * NOISE_MM**2, (n, 1, 1)),
        temperature_c=table[:, 4],
        elevation_rad=table[:, 3],
        azimuth_rad=table[:, 2],
        tool_offsets=TOOL[None],
    )
    return Measured(seen, np.array(rolls))


def turned_bar(azimuth: float, elevation: float, roll: float) -> np.ndarray:
    """Return the rotation (3, 3): first a roll about X, then the elevation (X upwards), then the azimuth about Z."""
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    cr, sr = math.cos(roll), math.sin(roll)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[ce, 0.0, -se], [0.0, 1.0, 0.0], [se, 0.0, ce]])
    about_z = np.array([[ca, -sa, 0.0], [sa, ca, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)
