"""Scatter of the homing of a machine, as a trial has measured it, and what it means for the accuracy after a homing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from agent.probing.ball import FittedBall
from agent.probing.preparation import PreparationResult
from agent.results.facts import Quantity, triple
from twin.arrays import Array
from twin.artefact.homing_scatter import homing_scatter
from twin.artefact.touch_pattern import centre_covariance, known_radius_covariance
from twin.machine.error_model import ErrorModel
from twin.machine.homing_effect import homing_effect
from twin.machine.volumetric import evaluation_grid
from twin.units import UM_PER_MM

GRID_SHAPE = (20, 10, 10)
"""Points of the grid over which the effect of a homing is computed. Its field is smooth."""
Triple = tuple[float, float, float]
Limits = tuple[float, float]

NOT_KNOWN = "not known; volcal try --homing 5 measures the scatter of the homing"


@dataclass(frozen=True)
class HomingScatter:
    """Scatter of the homing of X, Y and Z, measured with `homings` homings.

    `sigma_um` contains the standard deviation of the displayed zero of each axis from homing to homing, and `limits_um`
    the limits in which the true one is with the probability `confidence`. `touches_um` contains the standard deviation
    with which the touches alone repeat the centre of the ball; it is subtracted. `offsets_um` contains, for each
    homing, how far the ball was found from the mean of all homings.
    """

    homings: int
    sigma_um: Triple
    limits_um: tuple[Limits, Limits, Limits]
    touches_um: Triple
    confidence: float
    offsets_um: tuple[Triple, ...]

    @classmethod
    def of(cls, prepared: PreparationResult, found: Sequence[FittedBall]) -> Self:
        """Return the scatter that the ball shows that was `found` after each homing. The repeatability of the probe in
        `prepared` tells which part of it is that of the touches."""
        centres = np.array([ball.centre_mm for ball in found])
        touches = np.sqrt(np.diag(_centre_covariance(prepared)))
        axes = homing_scatter(centres, touches)
        x, y, z = ((UM_PER_MM * one.lower, UM_PER_MM * one.upper) for one in axes)
        return cls(
            homings=len(found),
            sigma_um=triple(UM_PER_MM * np.array([one.sigma for one in axes])),
            limits_um=(x, y, z),
            touches_um=triple(UM_PER_MM * touches),
            confidence=axes[0].confidence,
            offsets_um=tuple(triple(row) for row in UM_PER_MM * (centres - centres.mean(axis=0))),
        )

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        x, y, z = ((low, high) for low, high in record["limits_um"])
        return cls(
            record["homings"],
            triple(np.array(record["sigma_um"])),
            (x, y, z),
            triple(np.array(record["touches_um"])),
            record["confidence"],
            tuple(triple(np.array(row)) for row in record["offsets_um"]),
        )

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Name and text of the scatter of each axis."""
        return tuple((f"Homing of {axis}", self._text(number)) for number, axis in enumerate("XYZ"))

    def _text(self, axis: int) -> str:
        low, high = self.limits_um[axis]
        sigma = self.sigma_um[axis]
        return (
            f"2σ {2.0 * sigma:.2f} µm ({self.confidence:.0%}: {2.0 * low:.2f} to {2.0 * high:.2f}) of {self.homings} "
            f"homings, without the repeatability of the touches, 2σ {2.0 * self.touches_um[axis]:.2f} µm"
        )

    def as_json(self) -> dict[str, object]:
        return {
            "homings": self.homings,
            "sigma_um": list(self.sigma_um),
            "limits_um": [list(limits) for limits in self.limits_um],
            "touches_um": list(self.touches_um),
            "confidence": self.confidence,
            "offsets_um": [list(offset) for offset in self.offsets_um],
        }


def _centre_covariance(prepared: PreparationResult) -> Array:
    """Return the covariance (3, 3) in mm² of a centre of the ball that is measured repeatedly. An error of a fixed
    radius displaces all centres equally, so it is not part of it."""
    probing = prepared.rules.probing
    sigma_mm = probing.touch_sigma_mm
    if prepared.repeatability is not None:
        sigma_mm = 0.5 * prepared.repeatability.two_sigma_um / UM_PER_MM
    sigma_mm = max(sigma_mm, 1e-9)
    if probing.stylus is not None and probing.stylus.fixed:
        return known_radius_covariance(probing.directions, sigma_mm, 0.0)
    return centre_covariance(probing.directions, sigma_mm)


@dataclass(frozen=True)
class MeasuredHoming:
    """Scatter of the homing that the trial `run_id` has measured; `measured` is the UTC time of its end in ISO 8601."""

    run_id: str
    measured: str
    scatter: HomingScatter


@dataclass(frozen=True)
class AfterHoming:
    """Effect of the next homing on a machine whose errors a table corrects.

    `field_um` is the volumetric error that it is expected to add, because table and errors are then displaced against
    each other; it is an rms over the volume after removal of the best-fitting rigid motion. `offset_um` is the rms
    length by which it displaces all positions. This affects work that keeps a work offset over the homing, and no
    other.
    """

    homing: MeasuredHoming
    field_um: float
    offset_um: float

    @classmethod
    def of(cls, homing: MeasuredHoming, model: ErrorModel, factor: Array, tool_offset: Array) -> Self:
        """Return the effect on a machine with the errors `factor` (p, k), which `homing_effect` explains."""
        sigma_mm = np.array(homing.scatter.sigma_um) / UM_PER_MM
        grid = evaluation_grid(model.ranges_mm, GRID_SHAPE)
        effect = homing_effect(model, factor, tool_offset, sigma_mm, grid)
        return cls(homing, effect.aligned_um, math.sqrt(sum(sigma**2 for sigma in homing.scatter.sigma_um)))

    def with_homing(self, ve_um: float) -> float:
        """Return the volumetric error after a homing, from the one without, `ve_um`. Both parts are independent."""
        return math.hypot(ve_um, self.field_um)

    def as_json(self, ve: Quantity) -> dict[str, object]:
        """Return the JSON object that docs/reference/json.md describes, for a machine with the volumetric error
        `ve`."""
        homing = self.homing
        return {
            "run_id": homing.run_id,
            "measured": homing.measured,
            "homings": homing.scatter.homings,
            "sigma_um": list(homing.scatter.sigma_um),
            "limits_um": [list(limits) for limits in homing.scatter.limits_um],
            "field_um": self.field_um,
            "offset_um": self.offset_um,
            "ve_without_um": ve.value_um,
            "ve_um": self.with_homing(ve.value_um),
            "ve_limits_um": ve.limits_um and [self.with_homing(limit) for limit in ve.limits_um],
        }


def after_homing_text(record: Mapping[str, Any] | None) -> str:
    """Return what the next homing does to the accuracy, in words, from the JSON object of `AfterHoming`; None if it is
    not known."""
    if record is None:
        return NOT_KNOWN
    return (
        f"VE {record['ve_um']:.2f} µm instead of {record['ve_without_um']:.2f} (table and errors displaced: "
        f"{record['field_um']:.2g} µm); work offsets kept over it: {record['offset_um']:.1f} µm rms more; scatter of "
        f"run {record['run_id']}, {record['measured'][:10]}"
    )
