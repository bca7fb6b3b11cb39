"""Check of the position that a controller reports at the end of a motion.

Controllers have a window of their own for "in position", and a faulty one may confirm a motion that has not reached its
target. All drivers therefore compare the position reported after a motion with its target.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.errors import MotionFault

LINEAR_AXES = ("X", "Y", "Z")

ROUNDING = 1e-9
"""Difference beyond the limit that can come from the floating-point representation of two coordinates."""


def require_reached(
    reported: Sequence[float],
    target: Sequence[float],
    limit: float,
    what: str,
    where: Mapping[str, str],
    *,
    key: str = "position_tolerance_mm",
    axes: Sequence[str] = LINEAR_AXES,
    unit: str = "mm",
    decimals: int = 4,
    hint: str = "",
) -> None:
    """Raise MotionFault if an axis is farther than `limit` from its target.

    `reported` and `target` contain one coordinate per axis of `axes`, in `unit`. `what` names the motion, and `key` the
    setting of the limit. The error names the axis with the largest deviation, its target, the reported position and the
    limit. `where` is added to its locations.
    """
    deviations = [one - other for one, other in zip(reported, target, strict=True)]
    # A deviation that is no number is larger than any other; `max` alone would pass over it.
    index = max(range(len(deviations)), key=lambda number: _size(deviations[number]))
    deviation = deviations[index]
    if abs(deviation) <= limit + ROUNDING:
        return
    raise MotionFault(
        f"{what} ended off its target: {axes[index]} target {target[index]:.{decimals}f} {unit}, "
        f"reported {reported[index]:.{decimals}f} {unit}, off by {deviation:+.{decimals}f} {unit}, "
        f"limit {limit:g} {unit} ({key})",
        hint=hint
        or "check whether the machine was stopped, held, reset or jogged, the in-position window and the following "
        "error of the axis, and that the displayed position does not contain the active correction",
        **{**where, "axis": axes[index]},
    )


def _size(deviation: float) -> float:
    return math.inf if math.isnan(deviation) else abs(deviation)
