"""Drift of a machine between nights as its temperature sensors explain it: figures for table, JSON and figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import Any

import numpy as np

from agent.files import translated
from agent.history.schema import StoredRun
from agent.history.thermal_nights import ThermalNights, recorded_sensors, thermal_nights
from agent.settings.schema import Settings
from drivers.errors import InputError
from twin.arrays import Array
from twin.machine.volumetric import QuadraticForm, evaluation_grid
from twin.monitoring.thermal_drift import ThermalDrift, explain_thermal_drift
from twin.units import MICRO_UNITS, UM_PER_MM

SHOWN_ERRORS = 6
"""Number of parameters that table and figure show, those that the temperatures move most."""
_FACTOR = 2.0  # of standard uncertainty: a difference that is larger is called significant


@dataclass(frozen=True)
class PredictedNights:
    """Rms in µm over workspace and nights by which nights differ from their prediction by all other nights: `without`
    sensors and `with_sensors`. `gain_um2` is the mean decrease of the square, with its `standard_error_um2`."""

    without: float
    with_sensors: float
    gain_um2: float
    standard_error_um2: float

    @property
    def significant(self) -> bool:
        return self.gain_um2 > _FACTOR * self.standard_error_um2


@dataclass(frozen=True)
class SensorEffect:
    """One sensor: whether it explains the drift, or why not, and the rms change in µm of the error field over the
    workspace per K that its temperature rises alone. `log_evidence` is the logarithm of the factor that it contributes
    to the evidence; None for a sensor that cannot be used."""

    name: str
    taken: bool
    reason: str
    nights_left_out: int
    log_evidence: float | None
    field_um_per_k: float | None


@dataclass(frozen=True, eq=False)
class SensorDrift:
    """Drift between nights of one machine as explained by `found`, from its `history`. `form` (p, p) is the mean square
    in mm² of the error field after the best-fitting rigid motion is removed."""

    history: ThermalNights
    found: ThermalDrift
    form: Array

    @property
    def dates(self) -> tuple[datetime, ...]:
        """UTC times of the nights that were used."""
        return tuple(datetime.fromtimestamp(at, UTC) for at in self.history.started_s[self.found.nights].tolist())

    @property
    def days(self) -> Array:
        """Days (n,) of the nights that were used."""
        return self.found.fit.drift.days

    def date(self, day: float) -> datetime:
        """Return the UTC time of a day: between two nights by interpolation."""
        at_s = float(np.interp(day, self.days, self.history.started_s[self.found.nights]))
        return datetime.fromtimestamp(at_s, UTC)

    @cached_property
    def predicted(self) -> PredictedNights:
        """Errors of the prediction of left-out nights."""
        squares = [UM_PER_MM**2 * np.einsum("np,pq,nq->n", one, self.form, one) for one in self.found.left_out]
        with_sensors, without = squares
        gain = without - with_sensors
        error = float(np.std(gain, ddof=1)) / math.sqrt(len(gain))
        roots = [float(np.sqrt(np.mean(one))) for one in (without, with_sensors)]
        return PredictedNights(roots[0], roots[1], float(np.mean(gain)), error)

    @property
    def explained_um(self) -> float:
        """Rms in µm over workspace and nights of the change that the temperatures explain."""
        explained = self.found.explained
        away = explained - explained.mean(axis=0)
        return UM_PER_MM * math.sqrt(max(float(np.mean(np.einsum("np,pq,nq->n", away, self.form, away))), 0.0))

    @property
    def walk_um(self) -> float:
        """Rms change in µm of the error field in one day that no sensor explains."""
        synthesis = self.found.directions.synthesis
        return self.uncertainty_um((synthesis * self.found.fit.walk) @ synthesis.T)

    def change_um(self, change: Array) -> float:
        """Return the rms in µm of the error field over the workspace for a change (p,) of the parameters."""
        return UM_PER_MM * math.sqrt(max(float(change @ self.form @ change), 0.0))

    def uncertainty_um(self, covariance: Array) -> float:
        """Return the rms standard uncertainty in µm of the error field over the workspace for a covariance (p, p) of
        the parameters."""
        return UM_PER_MM * math.sqrt(max(float(np.vdot(self.form, covariance)), 0.0))

    @cached_property
    def sensors(self) -> tuple[SensorEffect, ...]:
        coefficients, _ = self.found.coefficients
        effects = []
        for verdict in self.found.screened.verdicts:
            if not verdict.usable:
                effects.append(SensorEffect(verdict.name, False, verdict.reason, verdict.left_out, None, None))
                continue
            place = self.found.sensors.index(verdict.name)
            taken = place in self.found.fit.taken
            field = self.change_um(coefficients[:, place])
            reason = "" if taken else "adds nothing that the nights support"
            gain = float(self.found.fit.log_gain[place])
            effects.append(SensorEffect(verdict.name, taken, reason, verdict.left_out, gain, field if taken else None))
        return tuple(effects)

    @cached_property
    def moved_errors(self) -> tuple[int, ...]:
        """Indices of the parameters that the temperatures of these nights move most, the most moved first."""
        weights = np.sqrt(np.diag(self.form))
        moved = weights * np.std(self.found.explained, axis=0)
        order = np.argsort(moved)[::-1][:SHOWN_ERRORS]
        return tuple(int(place) for place in order if moved[place] > 0.0)

    def unit(self, place: int) -> tuple[str, float]:
        """Return the unit in which a parameter is shown, and the factor from mm or rad."""
        return MICRO_UNITS[self.history.reference.model.parameters[place].unit]

    def as_json(self) -> dict[str, Any]:
        """Return the result as a mapping to be written as JSON (docs/reference/json.md)."""
        predicted, history = self.predicted, self.history
        return {
            "machine": history.machine.name,
            "nights": len(self.found.nights),
            "nights_without_temperatures": len(history.nights) - history.inseparable - len(self.found.nights),
            "nights_without_former_estimate": history.inseparable,
            "nights_without_file": history.without_file,
            "from": f"{self.dates[0]:%Y-%m-%d}",
            "to": f"{self.dates[-1]:%Y-%m-%d}",
            "sensors": [vars(one) for one in self.sensors],
            "log_evidence": self.found.fit.log_evidence,
            "explained_um": self.explained_um,
            "unexplained_um_per_day": self.walk_um,
            "left_out_nights": {
                "without_sensors_um": predicted.without,
                "with_sensors_um": predicted.with_sensors,
                "gain_um2": predicted.gain_um2,
                "standard_error_um2": predicted.standard_error_um2,
            },
            "errors": [self._error_json(place) for place in self.moved_errors],
        }

    def _error_json(self, place: int) -> dict[str, Any]:
        (unit, factor), (mean, sigma) = self.unit(place), self.found.coefficients
        effects = {
            name: {"value": factor * float(mean[place, at]), "standard_uncertainty": factor * float(sigma[place, at])}
            for at, name in enumerate(self.found.sensors)
            if at in self.found.fit.taken
        }
        return {"name": self.history.reference.model.names[place], "unit": unit, "per_k": effects}


def sensor_drift(runs: Sequence[StoredRun], settings: Settings, named: Sequence[str] = ()) -> SensorDrift:
    """Explain the drift between the `runs` of this machine, the oldest first, by the sensors `named`, or those of the
    settings.

    Raises InputError if there are too few nights, or if no sensor can be used; the message says why.
    """
    history = thermal_nights(runs, settings, recorded_sensors(runs, settings, named))
    with translated(InputError):
        found = explain_thermal_drift(history.nights, history.sensors, history.expected, history.steps)
        model = history.reference.model
        form = QuadraticForm.build(model, evaluation_grid(model.ranges_mm), history.tool_offset_mm)
    return SensorDrift(history, found, form.aligned)
