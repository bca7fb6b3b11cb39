"""Effects of axes, temperature and probe on measured ball centres which the identified model does not describe.

An effect displaces the ball centres of a run. Its sizes differ from machine to machine, are independent, and have mean
zero. It is described by fields: the displacement of every ball centre for one standard deviation of each size. The
Monte Carlo simulation draws the sizes, and the error budget in closed form takes their second moments.

An effect acts on the estimate only. The volumetric error before and after compensation is that of the machine in the
thermal state of the first ball, without lost motion. What an axis loses at a reversal, and what a machine deviates
while it is warm, comes in addition and is not contained in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.touch_pattern import determines_radius, perpendiculars
from twin.errors import DataError
from twin.machine.deviation_basis import deviation_basis_of_tools
from twin.machine.error_model import ErrorModel
from twin.thermal.growth_and_bending import SECOND_REGRESSOR_SHARE, GrowthAndBending
from twin.thermal.machine_drift import DriftPrior

LOST_MOTION, GROWTH, BENDING, LOBING = "lost motion", "machine growth", "machine bending", "probe lobing"

_LOBES = 3
_GROWING = "positioning"


class MeasurementEffect(Protocol):
    """Effect on the ball centres of a run. `name` names it in tables of influences."""

    @property
    def name(self) -> str: ...

    def fields(self, model: ErrorModel, planned: Observations) -> Array:
        """Return the displacements (n, 3, x) in mm of the n `planned` ball centres for one standard deviation of each
        of the x sizes of the effect. `model` is the error model of the true machines."""
        ...


@dataclass(frozen=True, eq=False)
class LostMotionEffect:
    """Lost motion of the axes: each slide lags behind its drive by half of it, against the direction of motion.

    `deviation_mm` is the standard deviation, over machines, of the lost motion of each axis at any place of its travel.
    Half of its variance is the same along the travel, and half belongs to a linear change along it. `directions`
    contains, for each tool, the directions (k, 3) of the k touches of a ball, as unit vectors towards the ball.
    """

    deviation_mm: float
    directions: Sequence[Array]
    name: str = LOST_MOTION

    def __post_init__(self) -> None:
        _check_size(self.deviation_mm, self.name)

    def fields(self, model: ErrorModel, planned: Observations) -> Array:
        low, high = np.array(model.ranges_mm).T
        along = 2.0 * (planned.axis_positions - low) / (high - low) - 1.0
        # b(u) = b₀ + b₁ √3 u with var b₀ = var b₁ = σ²/2 has, on the average over -1 ≤ u ≤ 1, the variance σ²
        sizes = self.deviation_mm * np.sqrt(0.5) * np.stack([np.ones_like(along), np.sqrt(3.0) * along], axis=2)
        # Display = slide + b/2 in the direction of motion; the touch senses the component along the outward normal -d.
        each = [centre_shifts(one, -0.5 * np.abs(one)) for one in self.directions]
        shifts = np.array(each)[planned.tool]
        found = shifts[:, :, :, None] * sizes[:, None, :, :]
        return np.asarray(found.reshape(planned.size, 3, -1))


@dataclass(frozen=True)
class WarmingEffect:
    """Machine whose temperature changes from the first to the last measured ball.

    If `bends` is False, scales and the tip position grow in proportion to the number of measured balls, and `rise_k` is
    the standard deviation, over machines, of the temperature change in K until the last ball.

    If `bends` is True, angles change and guides bow because the parts of the machine differ in temperature. They follow
    two independent regressors, as in `twin.thermal.growth_and_bending`: one grows in proportion to the number of balls,
    with the standard deviation `rise_k` until the last ball, and the other, for parts with a thermal lag, grows with
    the square of this number, with 0.4 (`SECOND_REGRESSOR_SHARE`) of that. The standard deviation of the temperature
    difference until the last ball is therefore rise_k * sqrt(1 + 0.4^2) = 1.077 rise_k.

    Sizes per kelvin are those of `prior`.
    """

    rise_k: float
    bends: bool
    prior: DriftPrior = field(default_factory=DriftPrior)

    def __post_init__(self) -> None:
        _check_size(self.rise_k, self.name)

    @property
    def name(self) -> str:
        return BENDING if self.bends else GROWTH

    def fields(self, model: ErrorModel, planned: Observations) -> Array:
        drift = GrowthAndBending(self.prior).unknowns(model, 2, np.ones(model.size, dtype=np.bool_))
        progress = np.arange(planned.size) / max(planned.size - 1, 1)
        regressors = self.rise_k * np.stack([progress, SECOND_REGRESSOR_SHARE * progress**2], axis=1)
        basis = deviation_basis_of_tools(model, planned.axis_positions, planned.tool, planned.tool_offsets)
        kinds = [model.parameters[index].kind for index in drift.parameter_indices] + [_GROWING] * 3
        grows = np.array([kind == _GROWING for kind in kinds])[drift.form]
        return drift.columns(basis, regressors)[:, :, grows != self.bends]


@dataclass(frozen=True, eq=False)
class LobingEffect:
    """Pretravel of the probe with three lobes around the stylus, largest for touches across the stylus.

    `amplitude_mm` is the root mean square, over machines, of the amplitude; the direction of the lobes is unknown.
    `directions` is that of `LostMotionEffect`.
    """

    amplitude_mm: float
    directions: Sequence[Array]
    name: str = LOBING

    def __post_init__(self) -> None:
        _check_size(self.amplitude_mm, self.name)

    def fields(self, model: ErrorModel, planned: Observations) -> Array:
        each = [centre_shifts(one, self.amplitude_mm * np.sqrt(0.5) * _lobes(one)) for one in self.directions]
        return np.asarray(np.array(each)[planned.tool])


def centre_shifts(directions: Array, outward_mm: Array) -> Array:
    """Return the shifts (3, x) in mm of a fitted ball centre for x sets of displacements of its k touches.

    `directions` (k, 3) are the unit vectors of the touches towards the ball, and `outward_mm` (k, x) the displacements
    of the touched points away from the ball. The radius is fitted too if the touches determine it; otherwise it is
    taken as known.
    """
    # A centre shift c and a change r of the radius move the point with the outward normal -d outwards by -d·c + r.
    columns = [-directions]
    if determines_radius(directions):
        columns.append(np.ones((len(directions), 1)))
    return np.asarray(np.linalg.lstsq(np.hstack(columns), outward_mm, rcond=None)[0][:3])


def _lobes(directions: Array) -> Array:
    """Return the cosine and the sine (k, 2) of three times the angle of k touches around the stylus, times their share
    across it. The first touch is along the stylus."""
    pole = directions[0]
    across = directions @ np.array(perpendiculars(pole)).T
    angle = _LOBES * np.arctan2(across[:, 1], across[:, 0])
    return np.asarray(np.hypot(*across.T)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _check_size(value: float, name: str) -> None:
    if not 0.0 <= value < np.inf:
        raise DataError(f"the size of the effect '{name}' must be finite and not negative, not {value}")
