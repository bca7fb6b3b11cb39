"""Context of a run. It comprises the devices and records that the run uses, and the hooks (functions) that the caller
of the run has passed to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.execution import steps as s
from agent.execution.device_assembly import Devices
from agent.execution.engine import Action, Engine, Observer
from agent.execution.journal import RunJournal
from agent.execution.rig import Rig
from agent.execution.run_lock import run_lock
from agent.execution.run_state import Announcement, Listener, RunStateTracker
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.reports.renderer import ReportRenderer, render_in_process
from drivers.clock import Clock


def _ignore_announcement(_: Announcement) -> None: ...


def _ignore_supervisor(_: Supervisor) -> None: ...


def _ignore_step(_: s.Step, __: object) -> None: ...


def _permit(_: Job, __: PreflightResult) -> None: ...


def _ignore_return() -> None: ...


def _no_answers(_: Mapping[type, Action]) -> Mapping[type, Action]:
    return {}


@dataclass(frozen=True)
class RunHooks:
    """Functions and objects that the caller passes to a run; the defaults are for a run that is not observed.

    `announce` receives states, progress and notes. `attach` receives the supervisor of the run, through which signals
    and endpoints hold or abort the run. `observe` receives every step and its result. `preflight_passed` receives the
    job that will be measured and the result of its preflight; it may raise an error to refuse the run. `return_begins`
    is called before the machine of a resumed run returns to the position of the interruption. `lock` prevents other
    processes from using the machine. `devices` creates the clock and the rig. `reports` renders the report of the run.
    If `write_files` is True, the results are also written to files; they are in the journal in any case. `answers`
    receives the actions of the steps of the run, by type of step, and returns actions that replace some of them.
    Campaigns use it to choose the way of a run, to interrupt its steps, and to carry out its motions without its
    computations.
    """

    announce: Listener = _ignore_announcement
    attach: Callable[[Supervisor], None] = _ignore_supervisor
    observe: Observer = _ignore_step
    preflight_passed: Callable[[Job, PreflightResult], None] = _permit
    return_begins: Callable[[], None] = _ignore_return
    lock: Callable[[Path, str], AbstractContextManager[None]] = run_lock
    devices: Devices = field(default_factory=Devices)
    reports: ReportRenderer = render_in_process
    write_files: bool = True
    answers: Callable[[Mapping[type, Action]], Mapping[type, Action]] = _no_answers


@dataclass(frozen=True)
class RunContext:
    """Objects that a run uses. `rig` comprises the devices, `engine` carries out the steps, and `tracker` journals and
    announces the state of the run. `clock` counts machine seconds; `supervisor`, which receives requests to hold or end
    the run, can interrupt the waits of this clock."""

    rig: Rig
    engine: Engine
    journal: RunJournal
    tracker: RunStateTracker
    supervisor: Supervisor
    clock: Clock
    hooks: RunHooks


def run_actions(
    rig: Rig, journal: RunJournal, tracker: RunStateTracker, supervisor: Supervisor, hooks: RunHooks
) -> dict[type, Action]:
    """Return the actions of all steps of a run: those of the devices in `rig`, and those of states, conclusions,
    decisions and proofs of plans that are chosen during the run. `hooks.answers` may replace them."""

    def conclude(step: s.Conclude) -> Any:
        result = step.compute()
        step.record(journal, result)
        return result

    def prove(step: s.ProvePlan) -> float:
        x, y, z = rig.machine.position().tolist()
        return step.prove((x, y, z), supervisor.check_stop_request)

    actions: dict[type, Action] = {
        **rig.actions(journal.run),
        s.Enter: lambda step: tracker.enter(step.state, step.reason()),
        s.Conclude: conclude,
        s.Decide: lambda step: step.choose(),
        s.ComputeOnce: lambda step: step.compute(),
        s.ProvePlan: prove,
    }
    return {**actions, **hooks.answers(actions)}
