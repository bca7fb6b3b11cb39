"""Options of the identification that a plan is evaluated with."""

from __future__ import annotations

from dataclasses import replace

from agent.settings.temperature import TemperatureSettings
from twin.design.measurement_setup import AS_STATED
from twin.identification import Options


def planning_options(temperature: TemperatureSettings) -> Options:
    """Return the options for planning: ball centres, all uncertainties as stated, and the thermometer of the run."""
    return replace(AS_STATED, temperature_standard_uncertainty_k=temperature.artefact_uncertainty_k)
