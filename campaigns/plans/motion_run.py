"""Kind of run with all motions and measurements of a calibration, but without identification. The run follows a random
branch of its plan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from agent.errors import GateRefused
from agent.execution import steps as s
from agent.execution.engine import Action
from agent.planning.branch_walk import Branch
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.planning.stand_ins import stand_in_answers
from agent.runs.kinds.calibration import CalibrationTask, calibration
from agent.runs.planned_run import PlannedRun, StartConditions
from drivers.clock import VirtualClock

REFUSED = "refused"
"""Key of the conclusion that refuses a run."""
BRANCH_STREAM = 3
"""Number of the random stream from which the branch is drawn."""


@dataclass
class CalibrationWithoutIdentification:
    """Kind of run with the plan of a full calibration. The branch that it follows is drawn with `seed` from those that
    the preflight walked; conclusions are answered by stand-ins.

    The preflight is computed once, from the position at which the first run starts. A
    second run of the same plan uses the same preflight and must therefore start at the same position.
    """

    seed: int
    name: str = "moving"

    def __post_init__(self) -> None:
        self.preflight: PreflightResult | None = None

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        task = CalibrationTask(job, start.store)
        if self.preflight is None:
            self.preflight = run_preflight(job, lambda _: calibration(task), start.start_mm, watch)
        return PlannedRun(job, self, start, self.preflight, lambda: calibration(task))

    @property
    def branch(self) -> Branch:
        """Branch that the run follows; it is known after the preflight."""
        assert self.preflight is not None
        ends = self.preflight.ends
        return ends[int(np.random.default_rng([self.seed, BRANCH_STREAM]).integers(len(ends)))]

    def answers(self, actions: Mapping[type, Action]) -> Mapping[type, Action]:
        """Return the actions of the steps that depend on an identification, for one run. `actions` are the usual
        ones."""
        number = count()

        def decide(step: s.Decide) -> str:
            way = self.branch.ways[next(number)]
            assert way in step.outcomes, f"{step.key} has no way {way!r}"
            return way

        return {
            **stand_in_answers(lambda step: actions[s.Enter](replace(step, reason=str))),
            s.Conclude: _stand_in,
            s.Decide: decide,
        }


def _stand_in(step: s.Conclude) -> object:
    if step.key == REFUSED:
        raise GateRefused("the drawn branch ends refused")
    return step.stand_in


class AlarmClock(VirtualClock):
    """Virtual clock that calls functions at given instants.

    The method `at(instant_s, action)` registers a function `action` that is called once the clock has reached
    `instant_s`. If the function `watch` is set, `watch(before_s, after_s)` is called before every advance of the clock
    from `before_s` to `after_s`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._alarms: list[tuple[float, Callable[[], None]]] = []
        self._earliest_s = math.inf
        self.watch: Callable[[float, float], None] | None = None

    def at(self, instant_s: float, action: Callable[[], None]) -> None:
        self._alarms.append((instant_s, action))
        self._earliest_s = min(self._earliest_s, instant_s)

    def advance_to(self, instant_s: float) -> None:
        if self.watch is not None and instant_s > self._now:
            self.watch(self._now, instant_s)
        super().advance_to(instant_s)
        if instant_s < self._earliest_s:
            return
        due = [alarm for alarm in self._alarms if alarm[0] <= instant_s]
        self._alarms = [alarm for alarm in self._alarms if alarm[0] > instant_s]
        self._earliest_s = min((alarm[0] for alarm in self._alarms), default=math.inf)
        for _, action in due:
            action()
