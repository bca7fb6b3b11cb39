"""Thermal drift of the machine during a run: whether it is estimated, its temperature model and its regressors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.settings.temperature import TemperatureSettings
from agent.thermal.readings import Conditions, machine_change_k
from agent.thermal.rules import drift_prior_of
from twin.arrays import Array
from twin.identification import Options
from twin.thermal.models import ThermalModel, choose_model
from twin.thermal.readings import MachineTemperatures


@dataclass(frozen=True, eq=False)
class RunDrift:
    """Drift of the machine while n balls were measured, at the instants `instants_s` (n,) in s.

    `regressors` (n, w) contains the thermal regressors in K that `model` gives for the temperatures of the run.
    """

    model: ThermalModel
    instants_s: Array
    regressors: Array


def is_drifting(temperature: TemperatureSettings, conditions: Sequence[Conditions]) -> bool:
    """Return True if the settings ask for a fit of the machine's thermal drift and the machine's temperature has
    changed by at least `temperature.min_change_k`."""
    change_k = machine_change_k(conditions, temperature.declared_change_k)
    return temperature.fit_machine_drift and change_k >= temperature.min_change_k


def run_drift(temperature: TemperatureSettings, conditions: Sequence[Conditions]) -> RunDrift | None:
    """Return the drift of the machine during measurements under `conditions`, one for each ball in the order of the
    observations. Return None if the machine did not drift, or if the drift is not to be estimated."""
    if not is_drifting(temperature, conditions):
        return None
    instants_s = np.array([one.instant_s for one in conditions])
    known = [one.machine_c for one in conditions if one.machine_c is not None]
    machine_c = np.array(known) if len(known) == len(conditions) else None
    change_k = machine_change_k(conditions, temperature.declared_change_k)
    model, regressors = choose_model(MachineTemperatures(instants_s, machine_c, change_k), drift_prior_of(temperature))
    return RunDrift(model, instants_s, regressors)


def thermal_options(temperature: TemperatureSettings, drift: RunDrift | None) -> Options:
    """Return the options of an identification that concern temperatures. With a drift, the estimate describes the
    machine at the time of the last observation."""
    return Options(
        temperature_standard_uncertainty_k=temperature.artefact_uncertainty_k,
        drift=None if drift is None else drift.model,
        state_regressors=None if drift is None else drift.regressors[-1],
    )
