"""Line of target positions that a machine approaches from both sides, as ISO 230-2 prescribes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivers.errors import InputError
from simulators.instruments.machine_under_test import RAPID_MM_PER_S, MachineUnderTest
from twin.arrays import Array

OVERRUN_MM = 1.0
"""Way beyond the last target, so that it is approached from both sides. It may lie outside the soft limits."""
STOP_S = 4.0
"""Time at each target for the reading."""
MOST_TARGETS, MOST_RUNS = 201, 20


@dataclass(frozen=True, eq=False)
class TargetLine:
    """Evenly spaced targets between the axis positions `start_mm` (3,) and `end_mm` (3,), both included, which are
    approached `runs` times in each direction.

    Raises InputError if the ends coincide or are not finite, or with fewer than 2 targets or 2 runs.
    """

    start_mm: Array
    end_mm: Array
    targets: int = 11
    runs: int = 5

    def __post_init__(self) -> None:
        if not (np.isfinite([self.start_mm, self.end_mm]).all() and self.length_mm > 0.0):
            raise InputError("the ends of a line must be two different positions in mm", key="from_mm")
        if not 2 <= self.targets <= MOST_TARGETS:
            raise InputError(f"a line has 2 to {MOST_TARGETS} targets, not {self.targets}", key="targets")
        if not 2 <= self.runs <= MOST_RUNS:
            raise InputError(f"a line is measured in 2 to {MOST_RUNS} runs, not {self.runs}", key="runs")

    @cached_property
    def length_mm(self) -> float:
        return float(np.linalg.norm(self.end_mm - self.start_mm))

    @property
    def direction(self) -> Array:
        """Unit vector (3,) along the line."""
        return np.asarray((self.end_mm - self.start_mm) / self.length_mm)

    @cached_property
    def along_mm(self) -> Array:
        """Distances (n,) of the targets from the start, in mm."""
        return np.linspace(0.0, self.length_mm, self.targets)

    @property
    def _visits(self) -> Sequence[float]:
        """Distances in mm of all stops; those outside the line are the overruns, where nothing is read."""
        up = [-OVERRUN_MM, *self.along_mm.tolist()]
        down = [self.length_mm + OVERRUN_MM, *self.along_mm[::-1].tolist()]
        return [distance for _ in range(self.runs) for distance in (*up, *down)]

    def visited_by(self, machine: MachineUnderTest) -> LineVisit:
        """Return what happens when `machine` visits the targets, one run after the other, from now on."""
        along = np.array(self._visits)
        travelled_s = np.cumsum(np.abs(np.diff(along, prepend=along[0]))) / RAPID_MM_PER_S
        at_s = machine.now_s + travelled_s + STOP_S * np.arange(1, len(along) + 1)
        displaced = machine.stops(self.start_mm + along[:, None] * self.direction, at_s)
        shape = (self.runs, 2, self.targets + 1)
        return LineVisit(
            displaced.reshape(*shape, 3)[:, :, 1:],
            at_s.reshape(shape)[:, :, 1:],
            float(at_s[-1] - machine.now_s),
        )


@dataclass(frozen=True, eq=False)
class LineVisit:
    """Displacements (runs, 2, n, 3) in mm of the tip at the targets, forwards and backwards, in the order of time: the
    backward run begins at the last target. `at_s` (runs, 2, n) are the instants, and `duration_s` is that of all runs.
    """

    displaced: Array
    at_s: Array
    duration_s: float


def by_target(in_order_of_time: Array) -> Array:
    """Return readings (runs, 2, n) in the order of the targets in both directions."""
    return np.stack((in_order_of_time[:, 0], in_order_of_time[:, 1, ::-1]), axis=1)


def scatter_of_mean(readings: Array) -> float:
    """Return the standard uncertainty (type A) of the bidirectional mean at a target, from readings (runs, 2, n): the
    scatter about the mean of each direction, pooled over all targets."""
    runs = len(readings)
    pooled = float(np.mean(readings.var(axis=0, ddof=1)))
    return float(np.sqrt(pooled / (2.0 * runs)))
