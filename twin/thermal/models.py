"""Table of the temperature models, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.error_model import ErrorModel
from twin.thermal.growth_and_bending import DriftByThermometer, DriftByTime
from twin.thermal.machine_drift import DriftPrior, MachineDrift
from twin.thermal.readings import MachineTemperatures


class ThermalModel(Protocol):
    """Temperature model: what the thermal drift of a machine depends on, and which errors drift."""

    def regressors(self, temperatures: MachineTemperatures) -> Array | None:
        """Return the thermal regressors (n, w) in K at the n instants of `temperatures`. They are zero at the first
        instant. Return None if the model needs temperatures that were not read."""

    def unknowns(
        self, model: ErrorModel, regressor_count: int, free: np.ndarray[Any, np.dtype[np.bool_]]
    ) -> MachineDrift:
        """Return the drift unknowns of the error model `model` with p parameters for `regressor_count` regressors. The
        mask `free` (p,) marks the parameters that are not held at zero."""


THERMAL_MODELS: Sequence[Callable[[DriftPrior], ThermalModel]] = (DriftByThermometer, DriftByTime)
"""All temperature models, each built from the prior per kelvin. The first one that can use the temperatures of a run is
the model of the run."""


def choose_model(temperatures: MachineTemperatures, prior: DriftPrior) -> tuple[ThermalModel, Array]:
    """Return the temperature model for the temperatures of a run, and its regressors (n, w) in K at their n instants.

    Raise DataError if no model can use these temperatures.
    """
    for build in THERMAL_MODELS:
        model = build(prior)
        regressors = model.regressors(temperatures)
        if regressors is not None:
            return model, regressors
    raise DataError("no temperature model can use the temperatures of this run")
