"""Return of compensation and machine to their state before an interruption. The return takes place between the last
recorded step of a resumed run and the first step that is carried out instead of replayed."""

from __future__ import annotations

from agent.errors import ArtefactMoved, PlanDiverged
from agent.execution.encoding import table_digest
from agent.execution.steps import (
    ActivateBank,
    AwaitActive,
    ComputeOnce,
    Decide,
    MoveTo,
    Plan,
    ReadActiveBank,
    ReadTable,
    StageTable,
    Step,
    TouchTowards,
)
from agent.probing import publish
from agent.runs.planned_run import PlannedRun
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.return_path import ReturnPath
from agent.runs.resume.step_trace import StepTrace
from agent.runs.run_context import RunContext
from agent.runs.run_results import RunResults
from drivers.errors import CommandRejected, MotionFault
from drivers.roles import Activation, MotionState
from twin.units import S_PER_MIN

WRITING = (ReadActiveBank, AwaitActive, ReadTable, StageTable, ActivateBank, Decide, ComputeOnce)
"""Types of steps that use only the compensation store or no device, so that the machine need not return for them."""


class ReturnToPosition:
    """Return of a resumed run to its state before the interruption.

    The compensation is restored before the first step that is carried out instead of replayed. The machine is moved
    back to its position before the first step whose type is not in `WRITING`. The step types in `WRITING` need no
    position, because they only read or write the compensation tables in the controller.
    """

    def __init__(
        self,
        prefix: str,
        planned: PlannedRun,
        results: RunResults,
        context: RunContext,
        trace: StepTrace,
        clock: ResumedClock,
        begun_s: float,
        time_s: float,
    ) -> None:
        """`prefix` is the beginning of the keys of all steps.

        `begun_s` is the machine time in s at which the run began, and `time_s` the one at which it continues.
        """
        self._prefix = prefix
        self._planned = planned
        self._results = results
        self._begun_s = begun_s
        self._rig = context.rig
        self._tracker = context.tracker
        self._return_begins = context.hooks.return_begins
        self._aside = context.engine.aside()
        self._journal = context.journal
        self._trace = trace
        self._clock = clock
        self._time_s = time_s
        self._activation = planned.start.store.activation
        self._compensated = False
        self.complete = False

    def before(self, following: Step) -> bool:
        taken_effect = False
        if not self._compensated:
            self._compensated = True
            taken_effect = self._return_compensation(following)
        if not isinstance(following, WRITING):
            self.complete = True
            self._return_machine(following)
        return taken_effect

    def _return_compensation(self, following: Step) -> bool:
        """Carry out `reactivation`; nothing moves. Return True if `following` has already taken effect."""
        self._clock.start_running(self._time_s)
        self._clear_fault()
        prefix = f"{self._prefix}/compensation"
        return self._aside.run(reactivation(prefix, self._trace, following, self._activation))

    def _return_machine(self, following: Step) -> None:
        """Withdraw the probe, and return to the position at which `following` begins."""
        self._return_begins()
        self._await_rest()
        refusal = self._planned.too_late(following, (self._clock.now() - self._begun_s) / S_PER_MIN)
        if refusal is not None:
            raise refusal
        if isinstance(following, (MoveTo, TouchTowards)):
            self._trace.last_motion.begin(following.target_mm, touch=isinstance(following, TouchTowards))
        self._trace.last_motion.forget_line()
        self._rig.last_motion = self._trace.last_motion
        prepared = self._results.prepared
        rules = self._planned.job.rules if prepared is None else prepared.rules
        path = ReturnPath(self._prefix, self._trace, rules, rules.drift.limit_mm)
        try:
            self._aside.run(path.plan(following))
        except ArtefactMoved as moved:
            self._discard_position(moved)
            raise
        self._tracker.announce_again()

    def _clear_fault(self) -> None:
        """Clear a fault that the interruption has left in the controller, such as an emergency stop.

        A person has removed the cause and asked for the resumption; the controller refuses if the cause is still there.
        """
        status = self._rig.machine.status()
        if status.state is not MotionState.FAULT:
            return
        try:
            self._rig.machine.reset()
        except CommandRejected as refusal:
            failure = MotionFault(
                f"the fault of the controller is still there: {status.fault}",
                hint="remove its cause, reset and reference the machine if necessary, then `volcal resume` again",
                **refusal.where,
            )
            self._journal.fault(failure)
            raise failure from refusal
        self._tracker.note(f"the fault of the controller is cleared: {status.fault}")

    def _discard_position(self, moved: ArtefactMoved) -> None:
        """Exclude all that was measured in the present pose of the mount, and note it; it is measured again."""
        pose = self._trace.pose
        assert pose is not None  # noqa: S101  only the balls of a pose are touched again
        balls = self._journal.discard_since(pose.key, str(moved))
        self._journal.fault(moved, pose.key)
        self._tracker.note(f"{balls} balls of this position are discarded, because {moved.message}", step=pose.key)

    def _await_rest(self) -> None:
        """Stop all devices and wait until the axes stand still.

        A motion of the interrupted process may still continue: a controller needs a second to notice that its client is
        gone, and the rotary drives do not notice it at all.
        """
        complaints = self._rig.stop()
        if complaints:
            self._tracker.note(f"stopping what may still move: {'; '.join(complaints)}")
        self._rig.await_standstill()


def reactivation(prefix: str, trace: StepTrace, following: Step, activation: Activation) -> Plan[bool]:
    """Restore the compensation to its state before the interruption.

    If necessary, write the staged table (the new compensation table that the run wrote into an inactive bank) into its
    bank again, and reactivate the bank that was active. Return True if `following`, the next step of the run, is an
    activation that took effect although it was interrupted.

    Raises PlanDiverged if a bank no longer contains the table that the run found there or wrote to it.
    """
    expected = trace.active_bank
    if expected is None or isinstance(following, AwaitActive):
        return False
    staged = trace.staged
    if staged is not None and not (isinstance(following, StageTable) and following.bank == staged.bank):
        yield from _restage(prefix, staged)
    active = yield ReadActiveBank(f"{prefix}/active-bank")
    if isinstance(following, ActivateBank) and active == following.bank:
        return True
    if expected:
        held = yield ReadTable(f"{prefix}/table", expected)
        if expected in trace.contents and (held is None or table_digest(held) != trace.contents[expected]):
            raise PlanDiverged(
                f"bank {expected} does not hold the table any more that was active when the run was interrupted",
                hint="it has been written since; start a new run",
                bank=expected,
            )
    if active != expected:
        yield from publish.activate(prefix, expected, activation)
    return False


def _restage(prefix: str, staged: StageTable) -> Plan[None]:
    """Write the staged table again if its bank has lost it.

    Raises PlanDiverged if that bank is active, because an active bank is never written.
    """
    held = yield ReadTable(f"{prefix}/staged", staged.bank)
    if held is not None and held.same_as(staged.table):
        return
    active = yield ReadActiveBank(f"{prefix}/acting")
    if active == staged.bank:
        raise PlanDiverged(
            f"bank {staged.bank} is active and does not hold the table that the run wrote",
            hint="it has been written since; restore the former table with `volcal resume --give-up`",
            bank=staged.bank,
        )
    yield StageTable(f"{prefix}/stage", staged.bank, staged.table)
    back = yield ReadTable(f"{prefix}/read-back", staged.bank)
    if back is None or not back.same_as(staged.table):
        raise PlanDiverged(f"bank {staged.bank} reads back differently from what was written", bank=staged.bank)
