"""Engine that carries out the steps of a plan.

It takes a step from the plan, journals it, carries it out, journals its result, and sends the result to the plan.

The engine is one short synchronous loop on one thread and depends neither on the meaning of a step nor on the devices.
Actions, which are looked up by the type of the step, carry the steps out; a `StepJournal` records them, and an observer
is informed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

from agent.execution.steps import STEPS_WITH_EFFECT, Plan, Step
from drivers.errors import VolcalError

T = TypeVar("T")

Action = Callable[[Any], Any]
Observer = Callable[[Step, object], None]


class StepJournal(Protocol):
    """Interface of the journal that the engine uses; every call returns when the record is durable."""

    def begin(self, step: Step) -> None: ...

    def finish(self, step: Step, result: object, *, begun: bool) -> None: ...

    def fail(self, step: Step, error: BaseException) -> None: ...

    def aside(self) -> StepJournal:
        """Return a journal for steps that do not belong to the procedure."""
        ...


class Engine:
    """Engine that runs plans. `actions` maps each type of step to the action that carries it out."""

    def __init__(
        self,
        actions: Mapping[type, Action],
        journal: StepJournal | None = None,
        observer: Observer | None = None,
    ) -> None:
        self._actions = dict(actions)
        self._journal = journal
        self._observer = observer

    def without_journal(self) -> Engine:
        """Return an engine with the same actions and observer but no journal, for a withdrawal that must be carried out
        although it cannot be journaled."""
        return Engine(self._actions, None, self._observer)

    def aside(self) -> Engine:
        """Return an engine with the same actions for withdrawals and returns.

        Their steps are journaled but skipped by a replay; they are not observed and therefore not counted.
        """
        return Engine(self._actions, None if self._journal is None else self._journal.aside())

    def run(self, plan: Plan[T]) -> T:
        """Run `plan` to its end and return its conclusion.

        A `VolcalError` raised by a step is re-raised with the key of that step. A `VolcalError` raised by the plan
        itself is re-raised with the key of the step whose result the plan had received last. The plan is closed in any
        case.
        """
        do = self._do if self._journal is None else self._do_durably
        observer = self._observer
        result: Any = None
        step: Step | None = None
        try:
            while True:
                step = plan.send(result)
                result = do(step)
                if observer is not None:
                    observer(step, result)
        except StopIteration as stop:
            conclusion: T = stop.value
            return conclusion
        except VolcalError as error:
            if step is not None:
                error.at(step=step.key)
            raise
        finally:
            plan.close()

    def _do(self, step: Step) -> Any:
        try:
            return self._actions[type(step)](step)
        except VolcalError as error:
            raise error.at(step=step.key) from error.__cause__

    def _do_durably(self, step: Step) -> Any:
        journal = self._journal
        assert journal is not None  # noqa: S101  chosen in `run`
        begun = isinstance(step, STEPS_WITH_EFFECT)
        if begun:
            journal.begin(step)
        try:
            result = self._do(step)
        except BaseException as error:
            journal.fail(step, error)
            raise
        journal.finish(step, result, begun=begun)
        return result
