"""Observations of the bare machine from measured balls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from agent.probing.position import MeasuredBall
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.held_out_check import HeldOutResiduals, held_out_residuals
from twin.artefact.observations import Observations

Correction = Callable[[Array], Array]


def observations_of(
    balls: Sequence[MeasuredBall],
    tool_offset_mm: Array,
    correction: Correction,
    thermal_regressors: Array | None = None,
) -> Observations:
    """Return observations in bare axis positions: the displayed ones plus the correction of the active table.

    `correction` maps displayed axis positions (n, 3) to the shift that the controller adds to them, (n, 3) mm;
    `thermal_regressors`: (n, w) K, of a machine that drifted.
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


def displayed_residuals(balls: Sequence[MeasuredBall], tool_offset_mm: Array, artefact: Artefact) -> HeldOutResiduals:
    """Return the residuals of the artefact's balls in the controller's own display, with the table active while
    measuring."""
    displayed = observations_of(balls, tool_offset_mm, no_correction)
    return held_out_residuals(displayed, displayed.axis_positions + tool_offset_mm, artefact)


def no_correction(displayed: Array) -> Array:
    return np.zeros_like(displayed)


def _renumbered(numbers: Iterable[int]) -> list[int]:
    """Return consecutive pose indices from 0 in the order of first occurrence."""
    seen: dict[int, int] = {}
    return [seen.setdefault(number, len(seen)) for number in numbers]
