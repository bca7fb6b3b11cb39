"""What motions leave behind on an axis: lost motion that its drive has to take up first, and a scatter."""

from __future__ import annotations

from simulators.scenario import AxisBehaviour
from simulators.world.field import ZERO
from simulators.world.noise import NoiseSource
from twin.collision.geometry import Point, point

STILL_MM = 1e-4
"""An axis whose target differs by less is not moved: no drive resolves it."""


class PlayOperator:
    """The play operator, axis by axis: the slide lags by half the backlash once its drive has gone that far.

    A slide stays wherever it is while its drive goes through the play, so that a short way back leaves part of the
    lag, and an axis that is not moved keeps what it had. The play may grow along the axis' own travel.
    """

    def __init__(self, behaviour: AxisBehaviour, seed: int) -> None:
        self._backlash_um = behaviour.backlash_of_axes_um
        self._growth_um_per_m = behaviour.backlash_growth_um_per_m
        self._sigma_mm = 1e-3 * behaviour.repeatability_um
        self._idle = not (any(self._backlash_um) or any(self._growth_um_per_m) or self._sigma_mm)
        self._noise = NoiseSource(seed, "axes")
        self._motions = 0
        self._lag: Point = ZERO
        self._scatter: Point = ZERO

    def after(self, start: Point, end: Point, step: int | None = None) -> Point:
        """(3,) mm by which the tip is off during and after a motion between two axis positions. `step`: a counter of
        the noise in place of that of the motions."""
        self._motions += 1
        if self._idle:
            return ZERO
        noise = self._noise.normal(self._motions if step is None else step) if self._sigma_mm else ZERO
        moved = [abs(e - s) > STILL_MM for s, e in zip(start, end, strict=True)]
        lag = [self._taken_up(axis, start[axis], end[axis]) if moved[axis] else self._lag[axis] for axis in range(3)]
        scatter = [self._sigma_mm * noise[axis] if moved[axis] else self._scatter[axis] for axis in range(3)]
        self._lag, self._scatter = point(lag), point(scatter)
        return point([one + other for one, other in zip(lag, scatter, strict=True)])

    def _taken_up(self, axis: int, start: float, end: float) -> float:
        half = 0.5e-3 * max(0.0, self._backlash_um[axis] + 1e-3 * self._growth_um_per_m[axis] * end)
        return min(max(self._lag[axis] - (end - start), -half), half)
