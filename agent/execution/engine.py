"""Engine that carries out the steps of a plan. A plan is a generator that yields steps and receives their results.

The engine takes a step from the plan, carries it out, writes its result to the journal, and sends the result to the
plan. A step that moves or changes something is also written to the journal before it is carried out.

The engine is a short synchronous loop on one thread. It depends neither on the meaning of a step nor on the devices.
The step is carried out by an action, a function that is found by the type of the step. A `StepJournal` records the
step, and an observer, a function given to the engine, is called with the step and its result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

from agent.errors import GateRefused, PlacementLost
from agent.execution.steps import STEPS_WITH_EFFECT, Conclude, Decide, Enter, Fork, Plan, RunPlan, Step
from drivers.errors import NotActiveYet, VolcalError

T = TypeVar("T")

Action = Callable[[Any], Any]
Observer = Callable[[Step, object], None]


class StepJournal(Protocol):
    """Methods that the engine needs of the journal, the database that records the steps of a run. A method that writes
    a record returns only when the record is safely on the disk.
    """

    def begin(self, step: Step) -> None: ...

    def finish(self, step: Step, result: object, *, begun: bool) -> None: ...

    def fail(self, step: Step, error: BaseException) -> None: ...

    def aside(self) -> StepJournal:
        """Return a journal for steps that are not part of the procedure of the run. A replay of the run skips such
        steps.

        Such steps withdraw the probe and restore the table if a run ends early, and move the probe back if the run is
        resumed.
        """
        ...


class Engine:
    """Engine that runs plans. A plan is a generator that yields steps and receives their results.

    `actions` maps each type of step to the function that carries it out. `journal` records the steps, and `observer` is
    called with each step and its result; both may be None.
    """

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
        """Return an engine with the same actions and the same observer as this engine, but without a journal.

        The run uses this engine to withdraw the probe if the journal can no longer be written.
        """
        return Engine(self._actions, None, self._observer)

    def aside(self) -> Engine:
        """Return an engine with the same actions as this engine, for steps that are not part of the procedure of the
        run.

        Such steps withdraw the probe and restore the table if a run ends early, and move the probe back if the run is
        resumed. They are journaled, but a resumed run skips them when it replays its journal. They are not passed to
        the observer and are therefore not counted.
        """
        return Engine(self._actions, None if self._journal is None else self._journal.aside())

    def run(self, plan: Plan[T]) -> T:
        """Run `plan` to its end and return the value that the plan returns. The plan, a generator, is always closed.

        If a step raises a `VolcalError`, the key of the step is added to the error. If the plan itself raises a
        `VolcalError`, the key of the last step whose result the plan received is added to the error. A step that raises
        `PlacementLost` or `NotActiveYet` raises this error inside the plan, which may go on with other steps.
        """
        do = self._do if self._journal is None else self._do_durably
        observer = self._observer
        result: Any = None
        step: Step | None = None
        try:
            step = plan.send(None)
            while True:
                try:
                    result = do(step)
                except (PlacementLost, NotActiveYet) as expected:
                    step = plan.throw(expected)
                    continue
                if observer is not None:
                    observer(step, result)
                step = plan.send(result)
        except StopIteration as stop:
            conclusion: T = stop.value
            return conclusion
        except VolcalError as error:
            # A refusal is a decision of the run, and an error after a conclusion or a state belongs to no step.
            if step is not None and not isinstance(error, GateRefused) and not isinstance(step, (Enter, Conclude)):
                error.at(step=step.key)
            raise
        finally:
            plan.close()

    def carry_out(self, plan: RunPlan) -> None:
        """Run `plan` and, at each decision, the way that is chosen, to the end of the run. Raises the same errors as
        `run`, and ValueError if a decision chooses a way that it has not declared, which is a defect of the plan.
        """
        fork = self.run(plan)
        while fork is not None:
            fork = self.run(self._chosen(fork))

    def _chosen(self, fork: Fork) -> RunPlan:
        way = self.run(_decided(fork))
        if way not in fork.ways:
            raise ValueError(f"{fork.key} has chosen {way!r}, which is not one of {list(fork.ways)}")
        return fork.ways[way]()

    def _do(self, step: Step) -> Any:
        try:
            return self._actions[type(step)](step)
        except GateRefused:
            raise
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
        except GateRefused:
            raise  # a decision of the run, not a fault of the step
        except BaseException as error:
            journal.fail(step, error)
            raise
        journal.finish(step, result, begun=begun)
        return result


def _decided(fork: Fork) -> Plan[str]:
    way: str = yield Decide(fork.key, tuple(fork.ways), fork.choose)
    return way
