"""The first ball of a position found again at its end: what drifted in between is told, and too much of it is a fault.

Nothing is corrected here. The second centre goes to the identification beside all others, each with its instant:
there one drift of the whole machine over the whole run is fitted to all of them together, which a straight line
through two touched balls of one position, each with its noise, cannot do as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agent.errors import MeasurementFault
from agent.execution.steps import Plan, Record
from twin.arrays import Array
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class DriftLimits:
    """Of the distance by which the first ball is found elsewhere: beyond the first an event, beyond the second a
    fault."""

    event_mm: float
    fault_mm: float


def judge_drift(key: str, drift_mm: Array, limits: DriftLimits) -> Plan[None]:
    """Record a drift (3,); raises MeasurementFault where it is beyond all use."""
    way_mm = float(np.linalg.norm(drift_mm))
    yield Record(f"{key}/drift", "event", _told(drift_mm, way_mm, limits))
    if way_mm > limits.fault_mm:
        raise MeasurementFault(
            f"the first ball moved by {UM_PER_MM * way_mm:.1f} µm within the position, "
            f"allowed {UM_PER_MM * limits.fault_mm:.1f} µm",
            hint="let machine and artefact settle, check that the mount is clamped",
            step=key,
        )


def _told(drift_mm: Array, way_mm: float, limits: DriftLimits) -> Mapping[str, object]:
    told: dict[str, object] = {"drift_um": UM_PER_MM * drift_mm, "limit_um": UM_PER_MM * limits.fault_mm}
    if way_mm > limits.event_mm:
        told["note"] = (
            f"the first ball moved by {UM_PER_MM * way_mm:.1f} µm within the position, "
            f"more than {UM_PER_MM * limits.event_mm:.1f} µm"
        )
    return told
