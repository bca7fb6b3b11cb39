"""From the section `[temperature]` of the settings to the rules of plans and of the identification."""

from __future__ import annotations

from agent.probing.position_drift import DriftLimits
from agent.probing.temperature_readings import Thermometers
from agent.probing.thermal_settling import SettlingRules
from agent.settings.schema import Settings
from twin.identification import DriftPrior
from twin.units import MM_PER_UM, S_PER_MIN

PER_UM_PER_M = 1e-6


def settling_of(settings: Settings) -> SettlingRules:
    chosen = settings.temperature
    thermometers = Thermometers(
        tuple(chosen.artefact_sensors), tuple(chosen.machine_sensors), chosen.declared_artefact_c
    )
    return SettlingRules(
        thermometers=thermometers,
        max_rate_k_per_h=chosen.max_rate_k_per_h,
        max_departure_k=chosen.max_departure_k,
        poll_interval_s=chosen.poll_interval_s,
        deadline_s=S_PER_MIN * chosen.max_wait_minutes,
    )


def drift_limits_of(settings: Settings) -> DriftLimits:
    fault_um = settings.procedure.drift_limit_um
    return DriftLimits(MM_PER_UM * min(settings.temperature.drift_warning_um, fault_um), MM_PER_UM * fault_um)


def drift_prior_of(settings: Settings) -> DriftPrior:
    chosen = settings.temperature
    return DriftPrior(
        strain_per_k=PER_UM_PER_M * chosen.scale_um_per_m_k,
        bending_per_k=PER_UM_PER_M * chosen.bending_um_per_m_k,
        tip_mm_per_k=MM_PER_UM * chosen.tip_um_per_k,
    )
