"""The first motion after a fault or an abort: out along the last approach direction, then straight back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.execution.steps import CheckPermissions, MoveTo, Plan, ReadPosition
from agent.execution.tip_trace import LastMotion
from agent.probing.ball import point
from agent.probing.paths.retreat import Retreat

WITHDRAW_FEED_MM_PER_S = 20.0


def withdraw(
    course: Retreat, stylus_axis: NDArray[np.float64], distance_mm: float, came: LastMotion | None = None
) -> Plan[None]:
    """Out along the last approach direction, back along the stylus by `distance_mm` slowly, then to the retreat plane;
    guarded all the way.

    `came`: how the tip came to where it is. A probe that is deflected at the start of a guarded move may leave its
    contact; that is what the slow first parts are for. A machine in fault does not move: a person looks first.
    """
    yield CheckPermissions("recover/permissions")
    here = np.array((yield ReadPosition("recover/here")))
    out = here if came is None else came.exit_point(here)
    if np.abs(out - here).max() > 0.0:
        yield MoveTo("recover/out", point(out), WITHDRAW_FEED_MM_PER_S)
    retreated = course.retreated(out)
    travel = abs(float((out - retreated)[course.retreat_axis]))
    first = out - stylus_axis * min(distance_mm, travel)
    yield MoveTo("recover/withdraw", point(first), WITHDRAW_FEED_MM_PER_S)
    yield MoveTo("recover/retreat", point(retreated))
