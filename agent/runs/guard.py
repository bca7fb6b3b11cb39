"""Guard of a run. If a run does not succeed, its guard leaves the machine as it was found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent.errors import Aborted, GateRefused, JournalFailed, PlanDiverged
from agent.execution.engine import Engine
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import RunPlan
from agent.planning.job import Job
from agent.probing import publish
from agent.probing.recovery import withdraw
from agent.runs.run_context import RunContext
from agent.runs.run_results import RunResults
from drivers.errors import LinkError, VolcalError


def carry_out_guarded(plan: RunPlan, job: Job, context: RunContext, results: RunResults) -> None:
    """Carry out `plan`, the plan of a run of `job`, until the run has reached a final state.

    A `VolcalError` (base class of the program's own errors) is not raised but stored in `results.error`. Unless it is
    the refusal of a gate, the machine is stopped, the probe is withdrawn, and the compensation that was active at the
    start of the run is restored and checked.

    A defect of the agent, in the plan or in one of these actions, is raised once the machine is as it was found.
    """
    guard = _Guard(job, context, results)
    try:
        context.engine.carry_out(plan)
    except GateRefused as refusal:
        results.error = refusal
        guard.end_refused(refusal)
    except VolcalError as error:
        results.error = error
        guard.leave_safely(error)
    except BaseException as defect:
        guard.leave_safely(_internal_error())
        for other in guard.defects:
            defect.add_note(f"{type(other).__name__}: {other}")
        raise
    if guard.defects:
        raise guard.defects[0]


class _Guard:
    """Actions at the end of a run that did not succeed. The steps are journaled aside from its procedure, or not at all
    if the journal fails. `defects` are errors of the agent itself in these actions, in the order in which they
    occurred; none of them keeps the next action from being done."""

    def __init__(self, job: Job, context: RunContext, results: RunResults) -> None:
        self._job = job
        self._context = context
        self._results = results
        self._engine: Engine = context.engine
        self._journal: RunJournal = context.journal
        self.defects: list[Exception] = []

    def end_refused(self, refusal: GateRefused) -> None:
        try:
            self._journal.decision("refused", {"reason": str(refusal)})
            self._context.tracker.enter(RunState.REFUSED, str(refusal))
        except VolcalError as error:
            self._results.error = error
            self.leave_safely(error)
        except Exception as defect:  # noqa: BLE001  it is raised once the machine is as it was found
            self.defects.append(defect)
            self.leave_safely(_internal_error())

    def leave_safely(self, error: VolcalError) -> None:
        """Stop the machine, withdraw the probe and restore the compensation.

        Failures of these actions are added to the reason of the final state, after `error`. A run that was aborted
        ends as faulted if its compensation could not be restored or if one of the actions has a defect.
        """
        context, aborted = self._context, isinstance(error, Aborted)
        context.supervisor.shield()
        self._engine, self._journal = self._engine.aside(), self._journal.aside()
        if isinstance(error, JournalFailed):
            self._engine = self._engine.without_journal()
        complaints = self._attempt("record the state", lambda: context.tracker.enter(RunState.ABORTING, str(error)))
        complaints += self._stop()
        complaints += self._attempt("bring the axes to a standstill", context.rig.await_standstill)
        if not isinstance(error, (LinkError, PlanDiverged)):
            complaints += self._attempt("withdraw the probe", self._withdraw)
        not_restored = self._attempt_restore()
        complaints += not_restored
        reason = self._results.end_reason = "; ".join([str(error), *complaints])
        end = RunState.ABORTED if aborted and not not_restored and not self.defects else RunState.FAULTED
        if isinstance(error, JournalFailed):  # not recorded when it occurred; it decides whether the run can go on
            self._attempt("record the fault", lambda: self._journal.fault(error))
        self._attempt("record the end", lambda: context.tracker.enter(end, reason))

    def _attempt(self, what: str, action: Callable[[], None]) -> list[str]:
        """Carry out `action` as `attempt` does. A defect of the agent is not raised either, but kept in `defects`,
        because the actions after this one matter more."""
        try:
            return attempt(what, action)
        except Exception as defect:  # noqa: BLE001  it is raised once the machine is as it was found
            return [f"could not {what}: {self._kept(defect)}"]

    def _kept(self, defect: Exception) -> VolcalError:
        """Keep `defect`, to be raised at the end, and return the error that stands for it in a reason."""
        self.defects.append(defect)
        return _internal_error()

    def _stop(self) -> list[str]:
        complaints: list[str] = []
        return self._attempt("stop the devices", lambda: complaints.extend(self._context.rig.stop())) + complaints

    def _withdraw(self) -> None:
        rules = self._job.rules
        axis, last_motion = np.asarray(rules.probing.stylus_axis), self._context.rig.last_motion
        self._engine.run(withdraw(rules.retreat, axis, rules.probing.retract_mm, last_motion))

    def _attempt_restore(self) -> list[str]:
        """Activate the former bank, and compare the table in it with the one before the run.

        If the journal fails, this is done without the journal. Return error texts, empty on success.
        """
        found = self._results.found
        if found is None or self._results.active_bank == found.bank:
            return []
        failure = self._failure(lambda: self._restore(found))
        if failure is not None:
            return [f"bank {found.bank} could not be made active again: {failure}"]
        self._results.active_bank = found.bank
        held: list[publish.ActiveCompensation] = []
        failure = self._failure(lambda: held.append(self._engine.run(publish.read_restored(found.bank))))
        if failure is not None:
            return [f"bank {found.bank} is active again, but its table could not be read: {failure}"]
        self._attempt("record what was restored", lambda: self._journal.table("restored", found.bank, held[-1].table))
        other = self._failure(lambda: publish.require_as_found(found, held[-1]))
        return [] if other is None else [str(other)]

    def _failure(self, action: Callable[[], None]) -> VolcalError | None:
        """Carry out `action`, and again without the journal if the journal fails. Return its error, None on success."""
        try:
            action()
        except JournalFailed:
            self._engine = self._engine.without_journal()
            return self._failure(action)
        except VolcalError as failure:
            return failure
        except Exception as defect:  # noqa: BLE001  it is raised once the machine is as it was found
            return self._kept(defect)
        return None

    def _restore(self, found: publish.ActiveCompensation) -> None:
        activation = self._context.rig.store.store_limits().activation
        self._engine.run(publish.restore(found.bank, after_fault=True, activation=activation))


def _internal_error() -> VolcalError:
    return VolcalError("internal error of the program", hint="save the diagnostics and report the error")


def attempt(what: str, action: Callable[[], None]) -> list[str]:
    """Carry out `action`. Return an empty list if it succeeds, and a list with its error text if it raises
    `VolcalError`.

    The error is not raised, because it would replace an earlier error that is being handled. `what` completes the text
    "could not …".
    """
    try:
        action()
    except VolcalError as failure:
        return [f"could not {what}: {failure}"]
    return []
