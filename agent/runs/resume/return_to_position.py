"""What a run that is gone on with does between the last recorded step and the first new one."""

from __future__ import annotations

from collections.abc import Callable

from agent.errors import PlanDiverged, PlanRefused
from agent.execution.encoding import table_digest
from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.execution.run_state import RunStateTracker
from agent.execution.steps import (
    ActivateBank,
    AwaitActive,
    MoveTo,
    Plan,
    ReadActiveBank,
    ReadTable,
    StageTable,
    Step,
    TouchTowards,
)
from agent.probing import publish
from agent.probing.position import PositionRules
from agent.runs.resume.replay_clock import ResumedClock
from agent.runs.resume.return_path import WayBack
from agent.runs.resume.step_trace import Trace
from drivers.roles import Activation


class Returning:
    """`aside` does steps that no replay will meet; `rules` as the run knows them by then; `time_s` machine seconds that
    it is by now."""

    def __init__(
        self,
        prefix: str,
        rig: Rig,
        trace: Trace,
        aside: Engine,
        rules: Callable[[], PositionRules],
        too_late: Callable[[Step], PlanRefused | None],
        tracker: RunStateTracker,
        clock: ResumedClock,
        time_s: float,
        activation: Activation,
    ) -> None:
        self._prefix = prefix
        self._rig = rig
        self._trace = trace
        self._aside = aside
        self._rules = rules
        self._too_late = too_late
        self._tracker = tracker
        self._clock = clock
        self._time_s = time_s
        self._activation = activation

    def compensation(self, following: Step) -> bool:
        self._clock.run_on(self._time_s)
        return self._aside.run(acting_again(f"{self._prefix}/compensation", self._trace, following, self._activation))

    def machine(self, following: Step) -> None:
        self._at_rest()
        refusal = self._too_late(following)
        if refusal is not None:
            raise refusal
        if isinstance(following, (MoveTo, TouchTowards)):
            self._trace.came.begins(following.target_mm, touch=isinstance(following, TouchTowards))
        self._rig.last_motion = self._trace.came
        rules = self._rules()
        way = WayBack(self._prefix, self._trace, rules, rules.drift.fault_mm)
        self._aside.run(way.plan(following))
        self._tracker.announce_again()

    def _at_rest(self) -> None:
        """What the process that died had begun may still go on: a controller that hears nothing takes a second to
        notice, and drives that turn do not know that anybody is missing."""
        complaints = self._rig.stop()
        if complaints:
            self._tracker.note(f"stopping what may still move: {'; '.join(complaints)}")
        self._rig.await_standstill()


def acting_again(prefix: str, trace: Trace, following: Step, activation: Activation) -> Plan[bool]:
    """Read back, compare, decide: the bank that acted acts again, and the bank that was written holds what was written.

    True where `following` is an activation that broke off and has taken effect all the same.
    """
    expected = trace.active_bank
    if expected is None or isinstance(following, AwaitActive):
        return False
    staged = trace.staged
    if staged is not None and not (isinstance(following, StageTable) and following.bank == staged.bank):
        yield from _written(prefix, staged)
    active = yield ReadActiveBank(f"{prefix}/active-bank")
    if isinstance(following, ActivateBank) and active == following.bank:
        return True
    if expected:
        held = yield ReadTable(f"{prefix}/table", expected)
        if expected in trace.contents and (held is None or table_digest(held) != trace.contents[expected]):
            raise PlanDiverged(
                f"bank {expected} does not hold the table any more that acted when the run broke off",
                hint="somebody has written it since; start a new run",
                bank=expected,
            )
    if active != expected:
        yield from publish.activate(prefix, expected, activation)
    return False


def _written(prefix: str, staged: StageTable) -> Plan[None]:
    """A bank may have lost what was written into it: it is written again, unless it acts."""
    held = yield ReadTable(f"{prefix}/staged", staged.bank)
    if held is not None and held.same_as(staged.table):
        return
    active = yield ReadActiveBank(f"{prefix}/acting")
    if active == staged.bank:
        raise PlanDiverged(
            f"bank {staged.bank} acts and does not hold the table that the run wrote",
            hint="somebody has written it since; restore the former table with `volcal resume --give-up`",
            bank=staged.bank,
        )
    yield StageTable(f"{prefix}/stage", staged.bank, staged.table)
    back = yield ReadTable(f"{prefix}/read-back", staged.bank)
    if back is None or not back.same_as(staged.table):
        raise PlanDiverged(f"bank {staged.bank} reads back differently from what was written", bank=staged.bank)
