"""First motion after a fault or an abort. The tip moves back against the last approach direction, then along the
stylus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.errors import MeasurementFault
from agent.execution.steps import CheckPermissions, MoveTo, Plan, ReadPosition
from agent.execution.tip_trace import LastMotion
from agent.probing.ball import point
from agent.probing.paths.retreat import Retreat

WITHDRAW_FEED_MM_PER_S = 20.0
OFF_LINE_MM = 10.0
"""Largest distance in mm of the reported position from the line of the last motion; more than the overtravel of a touch
and the deviation of a controller that blends two moves."""


def withdraw(
    retreat: Retreat, stylus_axis: NDArray[np.float64], distance_mm: float, last_motion: LastMotion | None = None
) -> Plan[None]:
    """Move the tip slowly back against the direction in which it arrived, then slowly along the stylus by
    `distance_mm`, then to the retreat plane, which no part of the artefact or mount reaches.

    `last_motion` is the motion by which the tip arrived; if it is None, the first move is left out. All moves are
    guarded: they stop if the probe trips. A guarded move may start with a deflected probe, because it must be able to
    leave a contact. For this reason, the first two moves are slow. The plan does not clear a fault of the machine,
    because a person must check the machine first. Raises MeasurementFault before any move if the machine reports a
    position that the last motion cannot have led to: axes whose display has jumped would move anywhere.
    """
    yield CheckPermissions("recover/permissions")
    here = np.array((yield ReadPosition("recover/here")))
    off_mm = 0.0 if last_motion is None else last_motion.distance_mm(here)
    if off_mm > OFF_LINE_MM:
        raise MeasurementFault(
            f"the machine reports a position {off_mm:.0f} mm off the line of its last motion: nothing is moved",
            hint="compare the displayed position, its unit and its zero with where the axes are, and move the probe "
            "free by hand",
        )
    out = here if last_motion is None else last_motion.exit_point(here)
    if np.abs(out - here).max() > 0.0:
        yield MoveTo("recover/out", point(out), WITHDRAW_FEED_MM_PER_S)
    retreated = retreat.at_retreat_plane(out)
    travel = abs(float((out - retreated)[retreat.retreat_axis]))
    first = out - stylus_axis * min(distance_mm, travel)
    yield MoveTo("recover/withdraw", point(first), WITHDRAW_FEED_MM_PER_S)
    yield MoveTo("recover/retreat", point(retreated))
