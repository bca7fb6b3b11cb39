"""Walk of a plan through all its branches on a simulated machine.

A plan ends in a decision (`Fork`) or with the run. At a decision, each way is walked on a copy of the simulated
machine, so that what comes before the decision is simulated once. At the first touch of each position, a copy is also
withdrawn as a run does that is stopped there, for example because the touch met nothing.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.execution.steps import UNKEYED, Conclude, Fork, Plan, RunPlan, Step, TouchTowards
from agent.planning.cycle_time import TimedStep
from agent.planning.safety_rules import SafetyRules, checked_plan
from agent.planning.stand_ins import MemoryStore, stand_in_answers
from agent.planning.time_model import TimeModel, takes_time
from agent.probing.position import PositionRules
from agent.probing.recovery import withdraw
from agent.probing.run_plan import MeasuredPositions
from drivers.clock import VirtualClock
from twin.units import S_PER_MIN

WITHDRAWN = "withdrawn"
"""Way of a branch in which the run is stopped and the probe withdrawn."""


@dataclass(frozen=True)
class Branch:
    """One way through a plan, from its start to the end of the run.

    `ways` contains the outcomes of its decisions in order. `keys` contains the keys of the steps that the journal of a
    run lists, in order. `timeline` maps the key of each step to the machine time in s at the end of the step, and
    `steps` contains the steps that take time. `concluded` maps the keys of conclusions to the measurements that they
    hold. `machine_seconds` is the simulated time of the whole branch.
    """

    ways: tuple[str, ...]
    keys: tuple[str, ...]
    timeline: dict[str, float]
    steps: tuple[TimedStep, ...]
    concluded: dict[str, MeasuredPositions]
    machine_seconds: float

    @property
    def name(self) -> str:
        return ", ".join(self.ways) or "to the end"

    @property
    def machine_minutes(self) -> float:
        return self.machine_seconds / S_PER_MIN

    @property
    def is_withdrawal(self) -> bool:
        return bool(self.ways) and self.ways[-1].startswith(WITHDRAWN)


@dataclass
class BranchWalk:
    """Simulated machine with its clock and store, and the steps of a plan that were walked on it so far."""

    rig: Rig
    clock: VirtualClock
    rules: SafetyRules
    model: TimeModel
    watch: Callable[[], None]
    position_rules: PositionRules | None
    store: MemoryStore = field(default_factory=MemoryStore)
    ways: tuple[str, ...] = ()
    keys: list[str] = field(default_factory=list)
    timeline: dict[str, float] = field(default_factory=dict)
    steps: list[TimedStep] = field(default_factory=list)
    concluded: dict[str, MeasuredPositions] = field(default_factory=dict)
    withdrawals: list[Branch] = field(default_factory=list)
    _entered: str = ""
    _last_s: float = 0.0

    def run(self, plan: Plan[Fork | None]) -> Fork | None:
        """Walk `plan` to its end, and return the decision in which it ends."""
        actions = {**self.rig.actions(), **self.store.actions(), **stand_in_answers()}
        return Engine(actions, observer=self._note).run(checked_plan(plan, self.rules))

    def expected(self, plan: RunPlan) -> Branch:
        """Walk `plan` on the way that is expected at each decision."""
        fork = self.run(plan)
        while fork is not None:
            self._decided(fork, fork.expected)
            fork = self.run(fork.ways[fork.expected]())
        return self.branch()

    def branches(self, plan: RunPlan) -> Iterator[Branch]:
        """Walk `plan` in every branch that is walked beforehand. The first branch is the expected one."""
        fork = self.run(plan)
        if fork is None:
            yield self.branch()
            return
        walked = fork.ways if fork.walked is None else fork.walked
        for way in sorted(walked, key=lambda name: name != fork.expected):
            fresh = self._copy()
            fresh._decided(fork, way)
            yield from fresh.branches(fork.ways[way]())
            self.withdrawals += fresh.withdrawals

    def branch(self) -> Branch:
        return Branch(self.ways, tuple(self.keys), self.timeline, tuple(self.steps), self.concluded, self.clock.now())

    def _copy(self) -> BranchWalk:
        rig, clock = copy.deepcopy((self.rig, self.clock))
        return BranchWalk(
            rig,
            clock,
            self.rules.copy(),
            self.model,
            self.watch,
            self.position_rules,
            self.store.copy(),
            self.ways,
            list(self.keys),
            dict(self.timeline),
            list(self.steps),
            dict(self.concluded),
            _entered=self._entered,
            _last_s=self._last_s,
        )

    def _decided(self, fork: Fork, way: str) -> None:
        self.ways = (*self.ways, way)
        self.keys.append(fork.key)

    def _note(self, step: Step, result: object) -> None:
        self.watch()
        if isinstance(step, Conclude):
            if isinstance(result, MeasuredPositions):
                self.concluded[step.key] = result
            return
        # Motion of the simulated machine advances the clock; latencies are added here.
        motion_s, overhead_s = self.clock.now() - self._last_s, self.model.overhead_s(step)
        self.clock.sleep(overhead_s)
        self._last_s = self.timeline[step.key] = self.clock.now()
        if motion_s or overhead_s or takes_time(step):
            self.steps.append(TimedStep(step, motion_s, overhead_s))
        if not isinstance(step, UNKEYED):
            self.keys.append(step.key)
        if isinstance(step, TouchTowards):
            self._withdraw_from(step)

    def _withdraw_from(self, touch: TouchTowards) -> None:
        """Withdraw a copy of the machine from the first touch of each position."""
        entered = touch.key.partition("/ball-")[0]
        if self.position_rules is None or entered == self._entered:
            return
        self._entered = entered
        rules, fresh = self.position_rules, self._copy()
        fresh.ways, fresh.position_rules = (*self.ways, f"{WITHDRAWN} from {touch.key}"), None
        axis, last = np.asarray(rules.probing.stylus_axis), fresh.rig.last_motion
        fresh.run(_to_the_end(withdraw(rules.retreat, axis, rules.probing.retract_mm, last)))
        self.withdrawals.append(fresh.branch())


def _to_the_end(plan: Plan[None]) -> RunPlan:
    yield from plan
    return None
