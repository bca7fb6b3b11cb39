"""The first motion after a fault or an abort: out along the stylus, nothing else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.execution.steps import CheckPermissions, MoveTo, Plan, ReadPosition
from agent.plans.ball import point
from agent.plans.course import Course

WITHDRAW_FEED_MM_PER_S = 20.0


def withdraw(course: Course, stylus_axis: NDArray[np.float64], distance_mm: float) -> Plan[None]:
    """Back along the stylus by `distance_mm` slowly, then to the retreat plane; guarded all the way.

    A probe that is deflected at the start of a guarded move may leave its contact; that is what the slow
    first part is for. A machine in fault does not move: a person looks first.
    """
    yield CheckPermissions("recover/permissions")
    here = np.array((yield ReadPosition("recover/here")))
    retreated = course.retreated(here)
    travel = abs(float((here - retreated)[course.retreat_axis]))
    first = here - stylus_axis * min(distance_mm, travel)
    yield MoveTo("recover/withdraw", point(first), WITHDRAW_FEED_MM_PER_S)
    yield MoveTo("recover/retreat", point(retreated))
