"""Engine of a resumed run, that is, the object that carries out the steps of the run's plan.

It takes the results of recorded steps from the journal and carries out only the remaining steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from agent.errors import PlacementLost, PlanDiverged
from agent.execution.encoding import LostPlacement, encode_step, table_digest
from agent.execution.engine import Action, Engine, Observer
from agent.execution.journal import RunJournal
from agent.execution.replay_log import RecordedStep, ReplayLog
from agent.execution.steps import UNKEYED, ReadTable, Step
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.step_trace import StepTrace
from drivers.roles import TableImage


class Return(Protocol):
    """Interface of an object that returns the compensation and the machine to their state before an interruption of a
    run.

    In this state the first step without a recorded result can be carried out.
    """

    @property
    def complete(self) -> bool:
        """True if compensation and machine are in the same state as before the interruption."""
        ...

    def before(self, following: Step) -> bool:
        """Restore compensation and machine as far as `following`, the next step of the run, needs them.

        Return True if `following` took effect before the interruption although the journal has no result of this step.
        """
        ...


class Replay:
    """Replay of the records of an interrupted run. It compares each record with the next step of the plan, which is
    built again when the run is resumed.

    `interrupted_step` is the step that had begun but not ended when the run was interrupted; it is None if there is no
    such step.
    """

    def __init__(self, recorded: ReplayLog, clock: ResumedClock, trace: StepTrace) -> None:
        self._recorded = recorded
        self._clock = clock
        self.trace = trace
        self.interrupted_step = recorded.unfinished

    @property
    def over(self) -> bool:
        return not self._recorded.steps

    def next(self, step: Step) -> RecordedStep:
        """Return the journal's record of `step`, which contains the result of the step. Raise PlanDiverged if the next
        record belongs to another step."""
        recorded = self._recorded.steps.popleft()
        _require_same(recorded, step)
        if recorded.finished_s is not None:
            self._clock.advance_to(recorded.finished_s)
        return recorded

    def end(self, step: Step) -> None:
        """End the replay before `step`, the first step without a recorded result. Raise PlanDiverged if the run was
        interrupted in a different step."""
        interrupted, self.interrupted_step = self.interrupted_step, None
        if interrupted is not None:
            _require_same(interrupted, step)


class ReplayingEngine(Engine):
    """Engine of a resumed run. It first returns the recorded results of steps, then carries out the remaining steps.

    `stored` is a function that returns a compensation table from the journal or the controller, given its CRC-32 and
    its bank.
    """

    def __init__(
        self,
        actions: Mapping[type, Action],
        journal: RunJournal,
        observer: Observer | None,
        replay: Replay,
        stored: Callable[[int, int], TableImage],
    ) -> None:
        super().__init__(actions, journal, observer)
        self._writer = journal
        self._replay = replay
        self._stored = stored
        self._return: Return | None = None

    def set_return(self, return_: Return) -> None:
        """Set `return_`, the object that restores the compensation and the machine position after the recorded steps
        have been replayed.

        If this method is not called, the engine assumes that the machine is still in the position in which the run was
        interrupted.
        """
        self._return = return_

    def _do_durably(self, step: Step) -> Any:
        result = self._replay_or_do(step)
        if self._return is None or not self._return.complete:
            self._replay.trace.add(step, result)
        return result

    def _replay_or_do(self, step: Step) -> Any:
        if isinstance(step, UNKEYED):
            # Conclusions are computed again from the journaled measurements; the journal compares their entries.
            return super()._do_durably(step)
        if not self._replay.over:
            return self._recorded(step)
        try:
            taken_effect = self._has_taken_effect(step)
        except PlacementLost as lost:
            # The next resumption must come to the same decision at the same step.
            self._writer.begin(step)
            self._writer.finish(step, LostPlacement(lost.message), begun=True)
            raise
        if taken_effect:
            # A step that writes is never carried out twice.
            self._writer.begin(step)
            self._writer.finish(step, None, begun=True)
            return None
        return super()._do_durably(step)

    def _recorded(self, step: Step) -> Any:
        result = self._replay.next(step).result
        if isinstance(result, LostPlacement):
            self._replay.trace.forget_placement()
            raise PlacementLost(result.reason, step=step.key)
        if isinstance(step, ReadTable) and result is not None:
            return self._stored(step.bank, result["crc32"])
        return result

    def _has_taken_effect(self, step: Step) -> bool:
        """Carry out the return as far as `step` needs it. Return True if `step` took effect before the interruption."""
        if self._return is None or self._return.complete:
            return False
        self._replay.end(step)
        return self._return.before(step)


def _require_same(recorded: RecordedStep, step: Step) -> None:
    key, kind = step.key, type(step).__name__
    if (recorded.key, recorded.kind) == (key, kind) and recorded.detail == encode_step(step):
        return
    asked = f"{kind} {key}" if (recorded.key, recorded.kind) != (key, kind) else f"{key} with other figures"
    raise PlanDiverged(
        f"the journal has {recorded.kind} {recorded.key} where the rebuilt plan asks for {asked}",
        hint="settings, files or software differ from those the run began with; start a new run",
        recorded=recorded.key,
        asked=key,
    )


def require_crc(image: TableImage | None, bank: int, crc32: int) -> TableImage:
    """Return `image`, the compensation table that was read from `bank` of the controller. Raise PlanDiverged if there
    is no table or its CRC-32 is not `crc32`."""
    if image is None or table_digest(image) != crc32:
        raise PlanDiverged(
            f"bank {bank} does not hold the table any more that it held when the run read it",
            hint="it has been written since; start a new run",
            bank=bank,
        )
    return image
