"""Rules on temperature: for measuring plans (thermal settling and drift limits) and for the identification of the
machine's errors (prior of the thermal drift). They are built from the section `[temperature]` of the settings."""

from __future__ import annotations

from agent.settings.schema import ProcedureSettings
from agent.settings.temperature import TemperatureSettings
from agent.thermal.position_drift import DriftLimits
from agent.thermal.readings import Thermometers
from agent.thermal.settling import SettlingRules
from twin.thermal.machine_drift import DriftPrior
from twin.units import MM_PER_UM, S_PER_MIN

PER_UM_PER_M = 1e-6


def settling_of(temperature: TemperatureSettings) -> SettlingRules:
    thermometers = Thermometers(
        tuple(temperature.artefact_sensors), tuple(temperature.machine_sensors), temperature.declared_artefact_c
    )
    return SettlingRules(
        thermometers=thermometers,
        max_rate_k_per_h=temperature.max_rate_k_per_h,
        max_departure_k=temperature.max_departure_k,
        poll_interval_s=temperature.poll_interval_s,
        deadline_s=S_PER_MIN * temperature.max_wait_minutes,
    )


def drift_limits_of(procedure: ProcedureSettings, temperature: TemperatureSettings) -> DriftLimits:
    limit_um = procedure.drift_limit_um
    return DriftLimits(MM_PER_UM * min(temperature.drift_warning_um, limit_um), MM_PER_UM * limit_um)


def drift_prior_of(temperature: TemperatureSettings) -> DriftPrior:
    return DriftPrior(
        strain_per_k=PER_UM_PER_M * temperature.scale_um_per_m_k,
        bending_per_k=PER_UM_PER_M * temperature.bending_um_per_m_k,
        tip_mm_per_k=MM_PER_UM * temperature.tip_um_per_k,
    )
