"""Drift of a machine between nights, as explained by its temperature sensors, and the machine at another temperature.

The estimates of n nights are reduced to the few directions of the error model that measurements see
(`seen_directions`), and sensors that can be used (`sensor_screening`) explain what these do from night to night
(`thermal_regression`). The machine now is the machine of the last calibration, moved by the coefficients times the
change of the temperatures since then:

    z(t) = z_L + D B (T(t) - T_L),   C(t) = C_L + D (ΔTᵀ Cov(B) ΔT + W (t - t_L)) Dᵀ,

with the directions D, the coefficients B and the variance W per day of the random walk that no sensor explains. This is
the prediction step of a Kalman filter whose known input are the temperatures (Anderson & Moore, Optimal Filtering,
1979, section 3.1). The update by positions measured since then is an identification with this state as its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array
from twin.errors import DataError
from twin.identification import CarriedOverPrior
from twin.monitoring.drift_evidence import MIN_NIGHTS, MOST_SENSORS, NightlyDrift
from twin.monitoring.seen_directions import SeenDirections, own_measurement
from twin.monitoring.sensor_screening import ScreenedSensors, screen_sensors
from twin.monitoring.thermal_regression import ThermalFit, explain_drift

EXTRAPOLATED_SHARE = 0.2
"""Distance from the temperatures of the nights, as a share of their range, beyond which a result is extrapolated.

What the stated uncertainty leaves out is that an effect may bend. The departure of a parabola from its tangent in the
middle of the range grows with the square of the distance from there. At this limit it is (0.7 / 0.5)² = 2 times that at
the ends of the range, the largest one that the nights could show; farther out nothing bounds it."""


@dataclass(frozen=True, eq=False)
class FusedWith:
    """Prior of an estimate that was fused with earlier nights: `mean` (p,) and `covariance` (p, p) of the parameters
    before this night measured."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class NightEstimate:
    """Estimate of p parameters with their covariance (p, p) in mm and rad, and the readings of s sensors of that night.

    `day` is the time in days. `readings_c` and `uncertainties_k` (s,) are in °C and K, NaN where a sensor gave no
    reading. `fused_with` is None if the estimate was made from the measurements of this night alone. `separable` is
    False if it was fused with an estimate that is not known: what this night measured cannot be told from what others
    did, which would count twice, at the temperatures of the wrong night. Nothing is learned from such a night.
    """

    day: float
    parameters: Array
    covariance: Array
    readings_c: Array
    uncertainties_k: Array
    fused_with: FusedWith | None = None
    separable: bool = True


@dataclass(frozen=True, eq=False)
class ThermalDrift:
    """Drift between nights as explained by sensors.

    `sensors` are the names of the sensors that can be used, in the order of `fit`; `screened` contains the verdict on
    all of them. `nights` contains the indices of the nights from which was learned: separable, and with readings of
    these sensors. `directions` are those that the nights see, to which the values of `fit` belong.
    """

    sensors: tuple[str, ...]
    screened: ScreenedSensors
    nights: NDArray[np.intp]
    directions: SeenDirections
    fit: ThermalFit

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the sensors that explain the drift."""
        return tuple(self.sensors[place] for place in self.fit.taken)

    @property
    def learned_c(self) -> tuple[Array, Array]:
        """Lowest and highest temperature (s,) in °C of each usable sensor in the nights from which its effect was
        learned."""
        readings = self.fit.drift.temperatures_c
        return readings.min(axis=0), readings.max(axis=0)

    def extrapolated(self, temperatures_c: ArrayLike) -> tuple[int, ...]:
        """Return the indices of the usable sensors whose temperature in °C, of `temperatures_c` (s,), lies farther
        outside those of the nights than `EXTRAPOLATED_SHARE` of their range. A temperature that is NaN does not."""
        given, (lowest, highest) = np.asarray(temperatures_c, dtype=np.float64), self.learned_c
        outside = np.maximum(lowest - given, given - highest)
        return tuple(np.flatnonzero(outside > EXTRAPOLATED_SHARE * (highest - lowest)).tolist())

    @property
    def coefficients(self) -> tuple[Array, Array]:
        """Change (p, s) of each parameter per K of each usable sensor, and its standard uncertainty, in mm or rad."""
        synthesis, fit = self.directions.synthesis, self.fit
        variances = np.einsum("pd,dss->ps", synthesis**2, fit.covariances)
        return synthesis @ fit.coefficients, np.sqrt(np.maximum(variances, 0.0))

    @property
    def explained(self) -> Array:
        """Part (n, p) of the parameters that the temperatures of each night explain, relative to mean temperatures."""
        above = self.fit.drift.temperatures_c - self.fit.reference_c
        return np.asarray(above @ self.fit.coefficients.T @ self.directions.synthesis.T)

    @property
    def explained_sigma(self) -> Array:
        """Standard uncertainties (n, p) of `explained`."""
        above = self.fit.drift.temperatures_c - self.fit.reference_c
        variances = np.einsum("ns,dst,nt->nd", above, self.fit.covariances, above)
        return np.asarray(np.sqrt(np.maximum(variances @ (self.directions.synthesis**2).T, 0.0)))

    @property
    def left_out(self) -> tuple[Array, Array]:
        """Differences (n, p) of the parameters of each night from their prediction by all other nights: with the
        sensors taken, and without sensors. A direction that a night did not see counts as zero."""
        fit, synthesis = self.fit, self.directions.synthesis
        return np.nan_to_num(fit.left_out) @ synthesis.T, np.nan_to_num(fit.left_out_without) @ synthesis.T

    def change(
        self, from_c: ArrayLike, to_c: ArrayLike, days: float, sigmas_k: ArrayLike | float = 0.0
    ) -> tuple[Array, Array]:
        """Return the expected change (p,) of the parameters from the temperatures `from_c` to `to_c` in °C of the
        usable sensors (s,), within so many days, and its covariance (p, p).

        `sigmas_k` (s,) are the standard uncertainties in K of the differences. Raises DataError if a temperature is
        missing of a sensor that explains the drift; one that does not counts as unchanged.
        """
        difference = np.asarray(to_c, dtype=np.float64) - np.asarray(from_c, dtype=np.float64)
        for place, name in enumerate(self.sensors):
            if place in self.fit.taken and not np.isfinite(difference[place]):
                raise DataError(
                    f"the temperature of the sensor {name}, which explains the drift, is not known",
                    hint="state the temperature of each sensor that explains the drift",
                )
        known = np.isfinite(difference)
        sigmas = np.broadcast_to(np.asarray(sigmas_k, dtype=np.float64), difference.shape)
        mean, variance = self.fit.change(np.where(known, difference, 0.0), np.where(known, sigmas, 0.0), days)
        synthesis = self.directions.synthesis
        return synthesis @ mean, np.asarray((synthesis * variance) @ synthesis.T)


def explain_thermal_drift(
    nights: Sequence[NightEstimate], sensors: Sequence[str], expected: ArrayLike, steps: Sequence[float] = ()
) -> ThermalDrift:
    """Explain the drift between nights, in the order of time, by the named sensors.

    `expected` (p, p) is the covariance of the parameters of machines of this kind, and `steps` contains the days at
    which the machine changed suddenly. Raises DataError if there are too few nights, no sensor can be used, or too many
    are named.
    """
    if not sensors:
        raise DataError("no temperature sensor is named")
    if len(sensors) > MOST_SENSORS:
        raise DataError(f"{len(sensors)} sensors are too many, at most {MOST_SENSORS} explain a drift")
    separable = np.array([one.separable for one in nights], dtype=np.bool_)
    count, lost = int(separable.sum()), int((~separable).sum())
    if count < MIN_NIGHTS:
        without = f"; {lost} more were fused with an estimate whose file is gone" if lost else ""
        raise DataError(
            f"{count} nights with an estimate are too few to explain a drift, {MIN_NIGHTS} are needed{without}",
            hint="measure more nights; a season of temperatures tells more than a week",
        )
    readings, sigmas = (np.array([getattr(one, name) for one in nights]) for name in ("readings_c", "uncertainties_k"))
    screened = screen_sensors(sensors, readings, sigmas)
    usable = list(screened.usable)
    if not usable:
        reasons = "; ".join(f"{one.name} {one.reason}" for one in screened.verdicts)
        raise DataError(f"no sensor can explain a drift: {reasons}")
    temperatures = screened.readings_c[:, usable]
    complete = np.flatnonzero(separable & np.isfinite(temperatures).all(axis=1))
    directions = SeenDirections.of(np.mean([one.covariance for one in nights], axis=0), expected)
    measured = [_measured(nights[at], directions) for at in complete.tolist()]
    drift = NightlyDrift(
        np.array([nights[at].day for at in complete.tolist()]),
        np.array([value for value, _ in measured]).reshape(-1, len(directions.gains)),
        np.array([variance for _, variance in measured]).reshape(-1, len(directions.gains)),
        temperatures[complete],
        tuple(steps),
    )
    names = tuple(sensors[place] for place in usable)
    return ThermalDrift(names, screened, complete, directions, explain_drift(drift))


def _measured(night: NightEstimate, directions: SeenDirections) -> tuple[Array, Array]:
    """Return what the night itself measured of the directions (d,), and its variances (d,)."""
    value, variance = _moments(night.parameters, night.covariance, directions)
    if night.fused_with is None:
        return value, variance
    return own_measurement(value, variance, *_moments(night.fused_with.mean, night.fused_with.covariance, directions))


def _moments(parameters: Array, covariance: Array, directions: SeenDirections) -> tuple[Array, Array]:
    analysis = directions.analysis
    return analysis @ parameters, np.einsum("dp,pq,dq->d", analysis, covariance, analysis)


def after_change(known: CarriedOverPrior, change: Array, covariance: Array) -> CarriedOverPrior:
    """Return an estimate as prior after its p parameters have changed by `change` (p,) with the covariance (p, p), in
    mm or rad. Parameters that the prior population holds at zero stay there."""
    scale, own = known.unknowns.scale, known.unknowns.blocks.parameters
    inverse = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    mean, wider = known.mean.copy(), known.covariance.copy()
    mean[own] += inverse * change
    wider[own, own] += inverse[:, None] * covariance * inverse
    return replace(known, mean=mean, covariance=wider)
