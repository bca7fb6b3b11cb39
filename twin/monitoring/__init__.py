"""Trends over nights: control charts, drift, sudden steps, and the time until a limit is reached."""

from twin.monitoring.control_chart import EwmaChart, IndividualsChart, ewma_chart, individuals_chart
from twin.monitoring.drift import Drift, LimitCrossing, fit_drift, limit_crossing
from twin.monitoring.steps import find_steps

__all__ = [
    "Drift",
    "EwmaChart",
    "IndividualsChart",
    "LimitCrossing",
    "ewma_chart",
    "find_steps",
    "fit_drift",
    "individuals_chart",
    "limit_crossing",
]
