"""Engine of a resumed run: recorded steps are answered from the journal, the rest is carried out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from agent.errors import PlanDiverged
from agent.execution.encoding import encode_step, table_digest
from agent.execution.engine import Action, Engine, Observer
from agent.execution.journal import RunJournal
from agent.execution.replay_log import RecordedStep, ReplayLog
from agent.execution.steps import ActivateBank, AwaitActive, ReadActiveBank, ReadTable, Record, StageTable, Step
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.step_trace import Trace
from drivers.roles import TableImage

WRITING = (ReadActiveBank, AwaitActive, ReadTable, StageTable, ActivateBank)
"""Steps of the compensation's store: nothing moves for them."""


class ReturnPath(Protocol):
    """Brings the machine back to where the next step can be carried out."""

    def compensation(self, following: Step) -> bool:
        """Reactivate the bank that was active; nothing moves. Return True if `following` has already taken effect."""
        ...

    def machine(self, following: Step) -> None:
        """Withdraw, and return to where the step began."""
        ...


class Replay:
    """Compares the steps of the rebuilt plan with the recorded ones. `unfinished`: the step that began and did not end,
    met once everything before it has been replayed."""

    def __init__(self, recorded: ReplayLog, clock: ResumedClock, trace: Trace) -> None:
        self._recorded = recorded
        self._clock = clock
        self.trace = trace
        self.unfinished = recorded.unfinished

    @property
    def over(self) -> bool:
        return not self._recorded.steps

    def next(self, step: Step) -> RecordedStep:
        """Return the recorded step that matches `step`. Raise PlanDiverged if it is another one."""
        recorded = self._recorded.steps.popleft()
        _require_same(recorded, step)
        if recorded.finished_s is not None:
            self._clock.replayed_to(recorded.finished_s)
        return recorded

    def require_unfinished(self, step: Step) -> None:
        if self.unfinished is not None:
            _require_same(self.unfinished, step)


class ReplayingEngine(Engine):
    """`stored` returns a table that the journal or the controller still has, by bank and CRC-32."""

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
        self._returning: ReturnPath | None = None
        self._compensated = self._arrived = False

    def returns_by(self, returning: ReturnPath) -> None:
        """Set the return path; to be called before the first plan is run."""
        self._returning = returning

    def _do_durably(self, step: Step) -> Any:
        result = self._done_or_recorded(step)
        if not self._arrived:
            self._replay.trace.see(step, result)
        return result

    def _done_or_recorded(self, step: Step) -> Any:
        if isinstance(step, Record):
            # Conclusions of the plan cost nothing; the journal knows which of them it already has.
            return super()._do_durably(step)
        if not self._replay.over:
            return self._recorded(step)
        if self._come_back(step):
            # It had taken effect before the interruption: a writing step is never carried out twice.
            self._writer.begin(step)
            self._writer.finish(step, None, begun=True)
            return None
        return super()._do_durably(step)

    def _recorded(self, step: Step) -> Any:
        result = self._replay.next(step).result
        if isinstance(step, ReadTable) and result is not None:
            return self._stored(step.bank, result["crc32"])
        return result

    def _come_back(self, step: Step) -> bool:
        """Return the compensation first, the machine only for a step that needs it; each once. True if `step`
        is already complete."""
        returning, done = self._returning, False
        if returning is None or self._arrived:
            return done
        if not self._compensated:
            self._replay.require_unfinished(step)
            self._compensated = True
            done = returning.compensation(step)
        if not isinstance(step, WRITING):
            self._arrived = True
            returning.machine(step)
        return done


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
    """Return the table. Raise PlanDiverged if the bank no longer holds it."""
    if image is None or table_digest(image) != crc32:
        raise PlanDiverged(
            f"bank {bank} does not hold the table any more that it held when the run read it",
            hint="somebody has written it since; start a new run",
            bank=bank,
        )
    return image
