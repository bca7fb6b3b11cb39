"""Session of a resumed run, which can end before the machine has returned to where the run was interrupted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from agent.errors import Aborted, Interrupted, JournalFailed, PlanRefused
from agent.execution.states import FINAL, RunState
from agent.planning.job import Job
from agent.runs.guard import attempt
from agent.runs.origin import Origin
from agent.runs.reconcile import reconcile, unproved_table
from agent.runs.reconcile_result import CompensationState, Reconciliation
from agent.runs.run_context import RunContext
from agent.runs.session import RunSession
from agent.runs.step_progress import StepProgress
from drivers.errors import DeviceError, UserError, VolcalError

_KEEPS_RUN = (UserError, DeviceError, Interrupted, JournalFailed)
"""Errors after which a run can be resumed again if nothing has moved yet. A plan that is refused or differs from the
recorded one would be so again."""
_AS_LEFT = (CompensationState.AS_EXPECTED, CompensationState.NOT_ACTIVATED, CompensationState.UNKNOWN)
"""States of the compensation that need not be named in the reason of an end."""


class ResumedSession(RunSession):
    """Session of a resumed run.

    The run has measured, and its table may be active without proof. An error before the return therefore leaves it
    resumable, unless a person stops the run or its plan is refused, and the reason of the end names such a table.
    """

    def __init__(self, context: RunContext, steps: StepProgress, job: Job, origin: Origin, began_s: float) -> None:
        """`began_s` is the wall-clock time in s at the beginning of the resumption."""
        super().__init__(context, steps, job, origin.kind, began_s)
        self._run = origin.start.run
        self._state_directory = origin.settings.state_directory
        self._compensation: str | None = None

    @contextmanager
    def compensation_compared(self) -> Iterator[None]:
        """Compare the compensation with the journal if the run ends in the `with` block with an error, and restore it
        if necessary. The devices must be open.

        The run's own exit path does not suffice: before the return nothing carries it out, and if the replay stops
        early, a new table may be active that the replay has not yet reached in the records.
        """
        try:
            yield
        except VolcalError:
            self._context.supervisor.shield()
            self._compare_compensation()
            raise
        if self.progress.error is not None:
            self._compare_compensation()

    def _compare_compensation(self) -> None:
        """Note the result of the comparison. A note that cannot be written does not hide how the run has ended."""
        try:
            found = reconcile(self._context.rig, self._state_directory, of_run=self._run)
            text = f"compensation: {_in_words(found)}"
            self._compensation = "" if found.state in _AS_LEFT else text
        except VolcalError as error:
            text = f"could not read the controller's compensation: {error}"
            self._compensation = "; ".join(part for part in (text, self._unproved_in_journal()) if part)
        attempt("note the compensation", lambda: self._context.tracker.note(text))

    def _unproved_in_journal(self) -> str:
        try:
            unproved = unproved_table(self._state_directory)
        except VolcalError:
            return ""
        return "" if unproved is None else unproved.situation

    def _enter_end(self, error: VolcalError) -> None:
        """Enter the end of a run that has not returned. What cannot be recorded does not hide the error."""
        journal, tracker = self._context.journal, self._context.tracker
        if tracker.state in FINAL:  # it has ended, and only closing the devices could not be noted
            return
        if self._compensation is None:  # the devices could not be opened
            self._compensation = self._unproved_in_journal()
        reason = "; ".join(part for part in (str(error), self._compensation) if part)
        self.progress.end_reason = reason
        if not isinstance(error, PlanRefused):
            before_return = isinstance(error, _KEEPS_RUN)
            attempt("record the fault", lambda: journal.fault(error, before_return=before_return))
        if isinstance(error, (Aborted, Interrupted)):
            attempt("record the state", lambda: tracker.enter(RunState.ABORTING, reason))
        attempt("record the end", lambda: tracker.enter(_end_after(error), reason))


def _end_after(error: VolcalError) -> RunState:
    if isinstance(error, Aborted):
        return RunState.ABORTED
    return RunState.REFUSED if isinstance(error, PlanRefused) else RunState.FAULTED


def _in_words(found: Reconciliation) -> str:
    """Return the result of the comparison in words. The ways out of an unproved table depend on the end of the run,
    which is not recorded yet, so that only the table is named."""
    if found.unproved is None:
        return found.text
    refused = f": {found.refused}" if found.refused else ""
    return f"{found.unproved.situation}{refused}"
