"""Kinds of interruption of one step of a run, and the objects that interrupt the run.

A step is interrupted before it begins, in its middle, or after its effect but before the effect is recorded in the
journal of the run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from agent.errors import Aborted
from agent.execution import steps as s
from agent.execution.engine import Action
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from campaigns.aborts.case import InMemoryDatabase
from campaigns.aborts.forked_copies import Forks
from campaigns.plans.motion_run import AlarmClock
from drivers.errors import CommandRejected, GuardTripped, LinkLost
from simulators.world.world import World

MOVING = (s.MoveTo, s.TouchTowards, s.OrientTo)
IMMEDIATE = (s.AskOperator, s.StageTable, s.ActivateBank)
"""Steps that take no time in this process; they are interrupted after their effect, before it is journaled."""


@dataclass(frozen=True)
class Interruption:
    """Interruption of one step of a run.

    `how` is the kind of the interruption, for example ``abort`` or ``disk full``. `when` is its instant: ``before`` the
    step, in the ``middle`` of the step, or ``after`` the effect of the step.
    """

    how: str
    when: str

    @property
    def name(self) -> str:
        return f"{self.how} {self.when}"


def interruptions_of(step: s.Step) -> list[Interruption]:
    """Return all interruptions that are possible for `step`."""
    ways = [
        Interruption(how, "before") for how in ("abort", "link", "link once", "fault", "refused", "disk full", "defect")
    ]
    if isinstance(step, MOVING):
        ways += [Interruption(how, "middle") for how in ("abort", "link", "link once", "fault")]
    if isinstance(step, IMMEDIATE):
        ways += [Interruption(how, "after") for how in ("abort", "link", "link once", "disk full")]
    if isinstance(step, s.MoveTo):
        ways.append(Interruption("guard", "before"))
    if isinstance(step, s.AskOperator):
        ways.append(Interruption("no", "before"))
    return ways


class BreakableLink:
    """Proxy of a device. Once `lost` is True, every method of the device except `close` raises LinkLost."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.lost = False

    def __getattr__(self, name: str) -> Any:
        if self.lost and name != "close":
            return self._fail
        return getattr(self._device, name)

    @staticmethod
    def _fail(*_: Any, **__: Any) -> Any:
        raise link_lost_error()


def link_lost_error() -> LinkLost:
    return LinkLost("connection reset", link="127.0.0.1:502")


@dataclass
class Interrupter:
    """Object that interrupts one run at its steps, each time in a forked child process.

    The function `selects(ordinal, step)` returns True if the step is to be interrupted. `results` contains the results
    of the child processes in the order of the forks.
    """

    world: World
    clock: AlarmClock
    memory: InMemoryDatabase
    selects: Callable[[int, s.Step], bool]
    forks: Forks = dataclasses.field(default_factory=Forks)
    results: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    supervisor: Supervisor | None = None
    link: BreakableLink | None = None
    ordinal: int = 0
    interruption: Interruption | None = None
    key: str = ""

    def rig(self, whole: Rig) -> Rig:
        """Return a rig that is equal to `whole`, except that its device is
        reached through a `BreakableLink`."""
        [(name, device)] = whole.devices.items()
        self.link = BreakableLink(device)
        roles: dict[str, Any] = dict.fromkeys(("machine", "probe", "store", "thermometer", "operator"), self.link)
        mounts: Any = dict.fromkeys(whole.mounts, self.link)
        return dataclasses.replace(whole, devices={name: self.link}, mounts=mounts, **roles)

    def answers(self, actions: Mapping[type, Action]) -> Mapping[type, Action]:
        """Return `actions` wrapped so that each step is carried out by `perform`, which can interrupt it."""
        return {kind: self._breakable(action) for kind, action in actions.items()}

    def _breakable(self, action: Action) -> Action:
        return lambda step: self.perform(action, step)

    def perform(self, action: Action, step: s.Step) -> Any:
        """Perform `step` with `action`, the function that normally carries it out, and return the result.

        If the step is to be interrupted, the process first forks one child for each possible interruption of the step.
        In a child the step is interrupted.
        """
        if self.forks.is_child:
            return action(step)
        self.ordinal += 1
        if self.selects(self.ordinal, step):
            for interruption in interruptions_of(step):
                result = self.forks.fork()
                if result is None:
                    self.interruption, self.key = interruption, step.key
                    return self._perform_interrupted(interruption, action, step)
                self.results.append({**result, "way": interruption.name, "step": step.key, "ordinal": self.ordinal})
        return action(step)

    def _perform_interrupted(self, interruption: Interruption, action: Action, step: s.Step) -> Any:
        if interruption.when == "before":
            self._interrupt(interruption.how)
            return action(step)
        if interruption.when == "middle":
            self.clock.watch = lambda now_s, _: self._interrupt_midway(interruption.how, now_s)
            return action(step)
        result = action(step)
        self._interrupt(interruption.how)
        return result

    def _interrupt_midway(self, how: str, now_s: float) -> None:
        self.clock.watch = None
        ends = (self.world.controller.motion_ends_s, self.world.workpiece.mount.settled_s)
        end_s = max(instant for instant in ends if instant is not None)
        self.clock.at(0.5 * (now_s + end_s), lambda: self._interrupt(how))

    def _interrupt(self, how: str) -> None:
        assert self.supervisor is not None
        assert self.link is not None
        match how:
            case "abort":
                self.supervisor.request_abort("SIGINT")
            case "link":
                self.link.lost = True
                raise link_lost_error()
            case "link once":
                raise link_lost_error()
            case "fault":
                self.world.controller.fail("door opened")
            case "refused":
                raise CommandRejected("the controller refused", device="twin")
            case "guard":
                raise GuardTripped("probe tripped in a guarded move")
            case "disk full":
                self.memory.fill()
            case "no":
                raise Aborted("the operator said no")
            case "defect":
                raise ZeroDivisionError("a defect of ours")
