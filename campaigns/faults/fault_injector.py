"""Beginning of the planned faults at their instants or steps, each night's in a copy of the process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from agent.execution import steps as s
from agent.execution.engine import Action
from agent.execution.rig import Rig
from agent.settings.schema import Settings
from campaigns.aborts.forked_copies import Forks
from campaigns.faults.fault_kinds import KINDS
from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.planned_night import PlannedNight, SecondFault
from drivers.clock import Clock

RETURN_PREFIX = "resume-"
"""Beginning of the keys of the steps with which a resumed run returns to where it was."""


@dataclass
class FaultInjector:
    """Object that forks a copy of the process at the instant of each night's first fault; the faults begin in the copy.

    `duration_s` is the machine time of an undisturbed night, and `received(night, result)` is called with the result of
    each copy. With a single night and `forked` False, the faults begin in this process.

    `begun` are the instants in s and kinds of the faults of the present run, and `sizes` describes them. `kinds` are
    those of all faults that have begun in the night, and `written` the CRC-32 of all tables that were handed to the
    controller. `touches` are the keys of all touches that the procedure has carried out, and `acknowledged` of those
    that are durable. `balls` is the number of acknowledged balls.
    """

    scene: FaultScene
    nights: Sequence[PlannedNight]
    duration_s: float
    received: Callable[[PlannedNight, Mapping[str, Any]], None]
    forked: bool = True
    forks: Forks = field(default_factory=Forks)
    night: PlannedNight | None = None
    begun: list[tuple[float, str]] = field(default_factory=list)
    sizes: list[str] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    written: list[int] = field(default_factory=list)
    touches: list[str] = field(default_factory=list)
    acknowledged: list[str] = field(default_factory=list)
    balls: int = 0
    runs: int = 0
    over: bool = False
    """True from the end of a run on: no fault begins any more."""
    second_begun: bool = False
    """True once the second fault of the night has begun, in the run or in its resumption."""
    _unacknowledged: str = ""

    def rig(self, clock: Clock, settings: Settings) -> Rig:
        """Return the rig of the run or of its resumption. Faults of the evening begin now, the others are arranged."""
        rig = self.scene.rig(clock, settings)
        self.balls = 0  # a resumed run observes those of the run before again
        if self.runs == 0:
            for night in self.nights:
                self._arrange_first(night)
        elif self.runs == 1 and self.night is not None and self.night.second is not None:
            self._arrange_second(self.night.second, resumed=True)
        return rig

    def end_run(self) -> None:
        """Let no fault begin until the next run."""
        self.over, self.runs = True, self.runs + 1

    def start_again(self) -> None:
        """Prepare for the resumption of the run."""
        self.over, self._unacknowledged = False, ""
        self.touches[:] = self.acknowledged  # one that the run before could not record is made again
        self.begun.clear()
        self.sizes.clear()
        self.scene.start_again()

    def _arrange_first(self, night: PlannedNight) -> None:
        if night.key:
            return
        if night.fraction == 0.0:
            self._begin_night(night)
        else:
            self.scene.clock.at(night.fraction * self.duration_s, lambda: self._begin_night(night))

    def _begin_night(self, night: PlannedNight) -> None:
        """Let the first fault begin in a copy of this process; in the copy of another night, do nothing."""
        if self.night is not None or self.over:
            return
        if self.forked:
            result = self.forks.fork()
            if result is not None:
                self.received(night, result)
                return
        self.night = night
        self._begin(night.kind, 1)
        if night.second is not None:
            self._arrange_second(night.second, resumed=False)

    def _arrange_second(self, second: SecondFault, *, resumed: bool) -> None:
        if second.resumed is resumed and not second.key:
            clock = self.scene.clock
            clock.at(clock.now() + second.delay_s, lambda: self._begin_second(second))

    def _begin_second(self, second: SecondFault) -> None:
        if not self.over and not self.second_begun:
            self.second_begun = True
            self._begin(second.kind, 2)

    def _begin(self, kind: str, number: int) -> None:
        assert self.night is not None
        self.begun.append((self.scene.clock.now(), kind))
        self.kinds.append(kind)
        self.scene.size = ""
        KINDS[kind].apply(self.scene, self.night.generator(number))
        self.sizes.append(f"{kind} {self.scene.size}".rstrip())

    def answers(self, actions: Mapping[type, Action]) -> Mapping[type, Action]:
        """Return `actions` wrapped so that faults can begin before or after a step."""
        return {kind: self._watched(action) for kind, action in actions.items()}

    def _watched(self, action: Action) -> Action:
        def perform(step: s.Step) -> Any:
            self._begin_at(step.key, after=False)
            result = action(step)
            if isinstance(step, s.TouchTowards) and not step.key.startswith(RETURN_PREFIX):
                self._unacknowledged = step.key
                self.touches.append(step.key)
            self._begin_at(step.key, after=True)
            return result

        return perform

    def _begin_at(self, key: str, *, after: bool) -> None:
        if self.night is None:
            for night in self.nights:
                if night.key == key and night.after is after:
                    self._begin_night(night)
            return
        second = self.night.second
        if second is None or (second.key, second.after, second.resumed) != (key, after, self.runs == 1):
            return
        self._begin_second(second)

    def observe(self, step: s.Step, _: object) -> None:
        """Count what the run has acknowledged; what it only repeats from its journal is not in `touches`."""
        self.balls += isinstance(step, s.Record) and step.kind == "ball"
        if step.key == self._unacknowledged:
            self._unacknowledged = ""
            self.acknowledged.append(step.key)
