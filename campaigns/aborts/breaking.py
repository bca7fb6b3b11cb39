"""Ways to break a run off at a step: before it begins, in its middle, after it has acted and before that is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from agent.errors import Aborted
from agent.execution import steps as s
from agent.execution.engine import Action
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from campaigns.aborts.case import Memory
from campaigns.aborts.forks import Forks
from campaigns.plans.moving import AlarmClock
from drivers.errors import CommandRejected, GuardTripped, LinkLost
from simulators.world.world import World

MOVING = (s.MoveTo, s.TouchTowards, s.OrientTo)
AT_ONCE = (s.AskOperator, s.StageTable, s.ActivateBank)
"""In this process these take no time: their middle is when they have acted and nobody knows yet."""


@dataclass(frozen=True)
class Way:
    """`how` it is broken off, and `when`: ``before`` the step, in its ``middle``, ``after`` it has acted."""

    how: str
    when: str

    @property
    def name(self) -> str:
        return f"{self.how} {self.when}"


def ways_of(step: s.Step) -> list[Way]:
    """Every way that this step can be broken off in."""
    ways = [Way(how, "before") for how in ("abort", "link", "link once", "fault", "refused", "disk full", "defect")]
    if isinstance(step, MOVING):
        ways += [Way(how, "middle") for how in ("abort", "link", "link once", "fault")]
    if isinstance(step, AT_ONCE):
        ways += [Way(how, "after") for how in ("abort", "link", "link once", "disk full")]
    if isinstance(step, s.MoveTo):
        ways.append(Way("guard", "before"))
    if isinstance(step, s.AskOperator):
        ways.append(Way("no", "before"))
    return ways


class CutLink:
    """A device as it is until its link is lost; then every call fails but to close."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.lost = False

    def __getattr__(self, name: str) -> Any:
        if self.lost and name != "close":
            return self._gone
        return getattr(self._device, name)

    @staticmethod
    def _gone(*_: Any, **__: Any) -> Any:
        raise lost_link()


def lost_link() -> LinkLost:
    return LinkLost("connection reset", link="127.0.0.1:502")


@dataclass
class Breaking:
    """What a broken run can be broken with. `left`: by the children, in order; `wanted` says at which steps they are
    made, by ordinal and step."""

    world: World
    clock: AlarmClock
    memory: Memory
    wanted: Callable[[int, s.Step], bool]
    forks: Forks = dataclasses.field(default_factory=Forks)
    left: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    supervisor: Supervisor | None = None
    link: CutLink | None = None
    ordinal: int = 0
    way: Way | None = None
    key: str = ""

    def rig(self, whole: Rig) -> Rig:
        """The same rig behind a link that can be lost, each of its actions open to be broken off."""
        [(name, device)] = whole.devices.items()
        self.link = CutLink(device)
        roles = dict.fromkeys(("machine", "probe", "store", "thermometer", "operator"), self.link)
        given = {field.name: getattr(whole, field.name) for field in dataclasses.fields(whole) if field.init}
        given |= {"devices": {name: self.link}, "mounts": dict.fromkeys(whole.mounts, self.link), **roles}
        return BreakableRig(self, given)

    def performed(self, action: Action, step: s.Step) -> Any:
        """Have the step done; before that, in as many copies of this process, have it go wrong."""
        if self.forks.is_child:
            return action(step)
        self.ordinal += 1
        if self.wanted(self.ordinal, step):
            for way in ways_of(step):
                result = self.forks.split()
                if result is None:
                    self.way, self.key = way, step.key
                    return self._broken(way, action, step)
                self.left.append({**result, "way": way.name, "step": step.key, "ordinal": self.ordinal})
        return action(step)

    def _broken(self, way: Way, action: Action, step: s.Step) -> Any:
        if way.when == "before":
            self._break(way.how)
            return action(step)
        if way.when == "middle":
            self.clock.watch = lambda now_s, _: self._break_in_the_middle(way.how, now_s)
            return action(step)
        result = action(step)
        self._break(way.how)
        return result

    def _break_in_the_middle(self, how: str, now_s: float) -> None:
        self.clock.watch = None
        ends = (self.world.controller.motion_ends_s, self.world.workpiece.mount.settled_s)
        end_s = max(instant for instant in ends if instant is not None)
        self.clock.at(0.5 * (now_s + end_s), lambda: self._break(how))

    def _break(self, how: str) -> None:
        assert self.supervisor is not None
        assert self.link is not None
        match how:
            case "abort":
                self.supervisor.request_abort("SIGINT")
            case "link":
                self.link.lost = True
                raise lost_link()
            case "link once":
                raise lost_link()
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


class BreakableRig(Rig):
    """A rig whose actions go through `Breaking.performed`."""

    def __init__(self, breaking: Breaking, given: dict[str, Any]) -> None:
        super().__init__(**given)
        self._breaking = breaking

    def actions(self, *given: Any, **named: Any) -> dict[type, Action]:
        return {kind: self._breakable(action) for kind, action in super().actions(*given, **named).items()}

    def _breakable(self, action: Action) -> Action:
        return lambda step: self._breaking.performed(action, step)
