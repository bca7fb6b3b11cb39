"""Measures of the volumetric error that the published studies show side by side.

The publication defines VE and VCE as the rms of the deviation over the workspace, without removing a rigid motion. Its
six terms are invisible to every artefact in an unknown pose, so this value contains a part that no procedure can
change. The other two measures leave that part out: the one as the set-up of a workpiece removes it, the other by the
rigid motion that fits best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from agent.studies.procedure_value import Verdict
from twin.machine.volumetric import VolumetricRms
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class ErrorMeasure:
    """Measure of a volumetric error: how much of the rigid motion of the workspace it contains.

    `key` names it in tables and summaries, and `title` in figures.
    """

    key: Literal["raw", "work_frame", "aligned"]
    title: str

    def um(self, verdict: Verdict) -> float | None:
        """Return the closed-form volumetric error of `verdict` in µm, or None if the machine is not identified."""
        if verdict.expected is None:
            return None
        if self.key == "work_frame":
            return None if verdict.in_work_frame_mm is None else UM_PER_MM * verdict.in_work_frame_mm
        return self.of(verdict.expected)

    def of(self, error: VolumetricRms | None) -> float | None:
        """Return the value of a simulated `error` in µm, or None if it is not known in this measure."""
        if error is None or self.key == "work_frame":
            return None
        return error.raw_um if self.key == "raw" else error.aligned_um


AS_DEFINED = ErrorMeasure("raw", "as defined")
WORK_FRAME = ErrorMeasure("work_frame", "in the work frame")
ALIGNED = ErrorMeasure("aligned", "rigidly aligned")
MEASURES = (AS_DEFINED, WORK_FRAME, ALIGNED)
"""As published; with the six rigid terms zero at the reference, as for a workpiece that is zeroed in the middle of the
travel and aligned along X and Y; and after the best-fitting rigid motion is removed."""


def values_before(before: Verdict) -> dict[str, object]:
    """Return the volumetric error without compensation in µm in each measure, for the summary of a study."""
    return {f"ve_{measure.key}_um": measure.um(before) for measure in MEASURES}


def share_of_gain(left: Sequence[float | None], before: float) -> tuple[float | None, ...]:
    """Return the reduction of the volumetric error for each of the errors `left` as a share of the largest reduction.

    `before` is the volumetric error without compensation, in the unit of `left`. A share is None if the machine is not
    identified, or if none of the errors is smaller than `before`.
    """
    best = min((value for value in left if value is not None), default=before)
    if best >= before:
        return (None,) * len(left)
    return tuple(None if value is None else (before - value) / (before - best) for value in left)
