"""Trends over nights: control charts, drift with steps set apart, and when a limit will be reached."""

from twin.trends.control_chart import Ewma, Individuals, ewma, individuals
from twin.trends.crossing import Crossing, crossing
from twin.trends.drift import Drift, fit_drift
from twin.trends.steps import find_steps

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
