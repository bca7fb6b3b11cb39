"""The engine: take a step, make it durable, have it done, make its result durable, send it back.

One short synchronous loop on one thread. It neither knows what a step means nor what drives the machine: a
`Performer` maps step types to actions, a `Journal` remembers, observers watch.
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
    """What the engine needs of a journal; both calls return when the record is durable."""

    def begin(self, step: Step) -> None: ...

    def finish(self, step: Step, result: object, *, begun: bool) -> None: ...

    def fail(self, step: Step, error: BaseException) -> None: ...

    def aside(self) -> StepJournal:
        """For steps that do not belong to the procedure."""
        ...


class Engine:
    """Runs plans. `actions` maps the type of a step to what does it."""

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
        """The same actions and observer, for a way out that must be gone although it cannot be written down."""
        return Engine(self._actions, None, self._observer)

    def aside(self) -> Engine:
        """The same actions for ways out and ways back: written down, never met by a replay, and not observed, so that
        nobody counts them in."""
        return Engine(self._actions, None if self._journal is None else self._journal.aside())

    def run(self, plan: Plan[T]) -> T:
        """Run `plan` to its end and return its conclusion.

        Errors of the house travel on with the key of the step they arose in, the plan's own with that of the step
        whose result made it give up; the plan is closed.
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
