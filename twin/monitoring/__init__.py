"""Trends over nights: control charts, drift with steps set apart, and when a limit will be reached."""

from twin.monitoring.control_chart import Ewma, Individuals, ewma, individuals
from twin.monitoring.crossing import Crossing, crossing
from twin.monitoring.drift import Drift, fit_drift
from twin.monitoring.steps import find_steps

__all__ = [
    "Crossing",
    "Drift",
    "Ewma",
    "Individuals",
    "crossing",
    "ewma",
    "find_steps",
    "fit_drift",
    "individuals",
]
