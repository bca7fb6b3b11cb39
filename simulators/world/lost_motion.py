"""Axis errors that remain after a motion: lost motion and limited repeatability."""

from __future__ import annotations

from simulators.scenario import AxisBehaviour
from simulators.world.field import ZERO
from simulators.world.noise import NoiseSource
from twin.collision.geometry import Point, point

STILL_MM = 1e-4
"""Smallest change of an axis target that counts as a move; drives do not resolve smaller changes."""


class PlayOperator:
    """Model of the backlash of each axis as a play operator: the slide (the moved part of the axis) lags its drive by
    up to half the backlash.

    The slide does not move while the drive, after a reversal, moves through the backlash. A reversal shorter than the
    backlash therefore changes the lag by less than the backlash. The lag of an axis that does not move is unchanged.
    The backlash may grow along the travel of the axis.
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
        """Return the tip offset, shape (3,), in mm during and after a motion from axis position `start` to `end`.

        The offset contains noise (limited repeatability). The step number `step` selects the noise; if it is None, the
        running number of the motion does.
        """
        self._motions += 1
        if self._idle:
            return ZERO
        noise = self._noise.normal(self._motions if step is None else step) if self._sigma_mm else ZERO
        moved = [abs(e - s) > STILL_MM for s, e in zip(start, end, strict=True)]
        # An axis that stands still keeps its lag and its scatter; a motion of the others does not move its slide.
        lag = [self._taken_up(axis, start[axis], end[axis]) if moved[axis] else self._lag[axis] for axis in range(3)]
        scatter = [self._sigma_mm * noise[axis] if moved[axis] else self._scatter[axis] for axis in range(3)]
        self._lag, self._scatter = point(lag), point(scatter)
        return point([one + other for one, other in zip(lag, scatter, strict=True)])

    def _taken_up(self, axis: int, start: float, end: float) -> float:
        # Play operator: the lag changes by the drive's travel and is clipped to ± half the local backlash.
        half = 0.5e-3 * max(0.0, self._backlash_um[axis] + 1e-3 * self._growth_um_per_m[axis] * end)
        return min(max(self._lag[axis] - (end - start), -half), half)
