"""From measured balls to observations of the bare machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from agent.probing.position import MeasuredBall
from twin.arrays import Array
from twin.artefact.observations import Observations

Correction = Callable[[Array], Array]


def observations_of(
    balls: Sequence[MeasuredBall],
    tool_offset_mm: Array,
    correction: Correction,
    thermal_regressors: Array | None = None,
) -> Observations:
    """Observations in bare axis positions: what the acting table added is added back to what was displayed.

    `correction` maps displayed axis positions (n, 3) to what the controller adds to them, (n, 3) mm; `course` (n, w) K
    of a machine that drifted.
    """
    displayed = np.array([ball.found.centre_mm for ball in balls])
    return Observations(
        position=np.array(_renumbered(ball.position for ball in balls)),
        ball=np.array([ball.ball for ball in balls]),
        tool=np.zeros(len(balls), dtype=np.int64),
        axis_positions=displayed + correction(displayed),
        covariance=np.array([ball.found.covariance_mm2 for ball in balls]),
        temperature_c=np.array([ball.temperature_c for ball in balls]),
        elevation_rad=np.array([math.radians(ball.elevation_deg) for ball in balls]),
        tool_offsets=tool_offset_mm.reshape(1, 3),
        thermal_regressors=np.zeros((len(balls), 0)) if thermal_regressors is None else thermal_regressors,
    )


def no_correction(displayed: Array) -> Array:
    return np.zeros_like(displayed)


def _renumbered(numbers: Iterable[int]) -> list[int]:
    """Consecutive pose indices from 0 in the order met."""
    seen: dict[int, int] = {}
    return [seen.setdefault(number, len(seen)) for number in numbers]
