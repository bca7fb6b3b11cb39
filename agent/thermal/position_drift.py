"""Drift during the measurement of a position: the displacement of the position's first ball when it is measured again
at the end. Excessive drift is a fault.

The drift is not corrected here. The centre from the repeated measurement enters the identification of the machine's
errors with its time, like all other centres. The identification fits the drift of the whole machine over the whole run
to all centres. This fit is more precise than a straight line through two noisy measurements of one ball.
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
    """Limits of the displacement of a position's first ball between its two measurements. If the displacement exceeds
    `warning_mm`, its journal record contains a note. If it exceeds `limit_mm`, MeasurementFault is raised."""

    warning_mm: float
    limit_mm: float


def judge_drift(key: str, drift_mm: Array, limits: DriftLimits) -> Plan[None]:
    """Record the displacement `drift_mm` (3,) of a position's first ball between its two measurements. Raises
    MeasurementFault if its length exceeds `limits.limit_mm`."""
    distance_mm = float(np.linalg.norm(drift_mm))
    yield Record(f"{key}/drift", "event", _payload(drift_mm, distance_mm, limits))
    if distance_mm > limits.limit_mm:
        raise MeasurementFault(
            f"the first ball moved by {UM_PER_MM * distance_mm:.1f} µm within the position, "
            f"allowed {UM_PER_MM * limits.limit_mm:.1f} µm",
            hint="let machine and artefact settle, check that the mount is clamped",
            step=key,
        )


def _payload(drift_mm: Array, distance_mm: float, limits: DriftLimits) -> Mapping[str, object]:
    payload: dict[str, object] = {"drift_um": UM_PER_MM * drift_mm, "limit_um": UM_PER_MM * limits.limit_mm}
    if distance_mm > limits.warning_mm:
        payload["note"] = (
            f"the first ball moved by {UM_PER_MM * distance_mm:.1f} µm within the position, "
            f"more than {UM_PER_MM * limits.warning_mm:.1f} µm"
        )
    return payload
