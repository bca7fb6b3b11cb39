"""Growth and bending of a machine that warms up or cools down.

Such a drift is smooth in space: scales expand, guides and columns bend, squareness changes, and the tip moves. It is
also smooth in time. Expansion follows one temperature. Bending follows the difference of two temperatures, and parts of
the machine may have a time lag.

The scale errors and the tip position therefore depend on the first regressor alone, which is the temperature rise.
Angles and bows depend on all regressors. The models of this module differ in their regressors only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.machine.error_model import ErrorModel, Parameter
from twin.machine.kinematic_chain import AXES
from twin.thermal.machine_drift import DriftPrior, MachineDrift
from twin.thermal.readings import MachineTemperatures, smooth_readings

SECOND_REGRESSOR_SHARE = 0.4
"""Size of the second regressor (for parts with a thermal lag) as a share of the total temperature change."""

Mask = np.ndarray[Any, np.dtype[np.bool_]]

_LOWEST_ORDER = {"positioning": 1, "rotation": 1, "straightness": 2}
"""Lowest Legendre order of a series by its kind: a scale, a linear tilt and a bow. Squareness has no series."""


@dataclass(frozen=True)
class GrowthAndBending:
    """Errors that change by growth and bending, whatever the regressors are."""

    prior: DriftPrior

    def unknowns(self, model: ErrorModel, regressor_count: int, free: Mask) -> MachineDrift:
        """Return the drift unknowns of the error model `model` with p parameters. The mask `free` (p,) marks the
        parameters that are not held at zero."""
        drifting = [(index, one) for index, one in enumerate(model.parameters) if _drifts(one) and free[index]]
        deviations = [self._per_k(one) * _lever_mm(model, one) for _, one in drifting]
        forms = range(len(drifting) + 3)  # the last three are those of the tip
        # Scales and the tip follow the first regressor alone; all others follow the further regressors too.
        bending = [form for form, (_, one) in enumerate(drifting) if one.kind != "positioning"]
        further = range(1, regressor_count)
        return MachineDrift(
            names=tuple(one.name for _, one in drifting),
            parameter_indices=tuple(index for index, _ in drifting),
            deviations=np.array([*deviations, *[self.prior.tip_mm_per_k] * 3]),
            form=np.array([*forms, *(form for _ in further for form in bending)]),
            regressor=np.array([*(0 for _ in forms), *(number for number in further for _ in bending)]),
        )

    def _per_k(self, parameter: Parameter) -> float:
        return self.prior.strain_per_k if parameter.kind == "positioning" else self.prior.bending_per_k


@dataclass(frozen=True)
class DriftByThermometer(GrowthAndBending):
    """Growth that follows the smoothed readings of the machine's thermometer. The second regressor, for parts with a
    time lag, is proportional to time."""

    @staticmethod
    def regressors(temperatures: MachineTemperatures) -> Array | None:
        if temperatures.machine_c is None:
            return None
        rise = smooth_readings(temperatures.instants_s, temperatures.machine_c)
        lag = SECOND_REGRESSOR_SHARE * temperatures.change_k * temperatures.relative_time
        return temperatures.since_first(rise, lag)


@dataclass(frozen=True)
class DriftByTime(GrowthAndBending):
    """Growth of a machine without a thermometer, whose temperature is assumed to change linearly with time. The second
    regressor, for parts with a time lag, is proportional to the square of time."""

    @staticmethod
    def regressors(temperatures: MachineTemperatures) -> Array:
        time = temperatures.relative_time
        rise = temperatures.change_k * time
        lag = SECOND_REGRESSOR_SHARE * temperatures.change_k * time**2
        return temperatures.since_first(rise, lag)


def _drifts(parameter: Parameter) -> bool:
    return parameter.kind == "squareness" or _LOWEST_ORDER.get(parameter.kind) == parameter.order


def _lever_mm(model: ErrorModel, parameter: Parameter) -> float:
    """Return the factor that converts a strain or an angle to the parameter. The factor is half the travel in mm for a
    displacement, and 1 for an angle."""
    if parameter.unit == "rad":
        return 1.0
    low, high = model.ranges_mm[AXES.index(parameter.error[2])]
    # The series are Legendre polynomials of the position normalised to ±1: the strain s over the travel L is s L/2
    # times P1. The bow is stated in the same unit, as a fraction of half the travel.
    return 0.5 * (high - low)
