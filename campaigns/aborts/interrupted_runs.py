"""Execution of the uninterrupted run, and of the same run with interruptions at its steps; check of the result."""

from __future__ import annotations

import gc
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agent.execution import steps as s
from agent.execution.device_assembly import Devices
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE, InMemoryDatabase, build_case_world, prepare_case
from campaigns.aborts.interruption_kinds import Interrupter
from campaigns.nights.play import build_rig
from campaigns.plans.motion_run import AlarmClock
from drivers.roles import CompensationStore, MotionState, TableImage

SETTLE_S = 60.0
POSITION_TOLERANCE_MM = 0.01
EXPECTED_REASONS = {
    "abort": "SIGINT",
    "link": "connection reset",
    "link once": "connection reset",
    "fault": "door opened",
    "refused": "the controller refused",
    "guard": "probe tripped in a guarded move",
    "disk full": "the journal cannot be written",
    "no": "the operator said no",
    "defect": "internal error of the program",
}
DEFECT = "a defect of ours"
BY_REQUEST = ("abort", "no")
WITHDRAWING = ("abort", "refused", "guard", "disk full", "no", "defect")
"""Interruptions after which the axes can and must withdraw. Without a link, or in a fault, nothing moves."""
MEASURING = ("measure/", "verify/", "probe/")
NEIGHBOURS = 4
"""Number of measurement steps always included before and after a step that reads or writes tables."""


@dataclass(frozen=True)
class StepSelection:
    """Selection of the steps of a run that one worker process interrupts.

    The workers together interrupt each step whose ordinal in the run is a multiple of `every`, and all steps near those
    that read or write compensation tables. The selected steps are distributed over `shares` workers: the worker with
    the number `share` takes the steps whose ordinal modulo `shares` equals `share`. `keys` are the keys of all steps of
    an uninterrupted run, in order; they show which steps near a given step read or write compensation tables.
    """

    share: int
    shares: int
    every: int
    keys: Sequence[str]

    def selects(self, ordinal: int, _: s.Step) -> bool:
        near = self.keys[max(ordinal - 1 - NEIGHBOURS, 0) : ordinal + NEIGHBOURS]
        chosen = ordinal % self.every == 0 or any(not key.startswith(MEASURING) for key in near)
        return chosen and ordinal % self.shares == self.share


def uninterrupted_keys() -> list[str]:
    """Carry out the run without interruption and return the keys of all its steps in order.

    The key of a step with an effect on the machine is marked with ``!`` at its end.
    """
    keys: list[str] = []

    def noted(_: int, step: s.Step) -> bool:
        keys.append(step.key + ("!" if isinstance(step, s.STEPS_WITH_EFFECT) else ""))
        return False

    with _case(noted) as (interrupter, directory):
        _complete(interrupter, directory)
    return keys


def run_interrupted(selection: StepSelection) -> list[dict[str, Any]]:
    """Carry out one run, fork copies of it that are interrupted at the selected steps, and return the results of these
    copies.
    """
    with _case(selection.selects) as (interrupter, directory):
        gc.freeze()
        _complete(interrupter, directory)
    return interrupter.results


@contextmanager
def _case(selects: Callable[[int, s.Step], bool]) -> Iterator[tuple[Interrupter, Path]]:
    memory = InMemoryDatabase.replace_files()
    with tempfile.TemporaryDirectory(prefix="volcal-aborts-") as name:
        try:
            yield Interrupter(build_case_world(), AlarmClock(), memory, selects), Path(name)
        finally:
            memory.restore_files()


def _complete(interrupter: Interrupter, directory: Path) -> None:
    """Carry out the run. In a child process, send the result and exit; in the parent, the run must complete."""
    defect: BaseException | None = None
    ended: RunResult | None = None
    try:
        ended = _carry_out(interrupter, directory)
    except BaseException as error:  # noqa: BLE001  a child must never continue as its parent
        defect = error
    if interrupter.forks.is_child:
        interrupter.forks.send_and_exit(_found(interrupter, ended, defect))
    if defect is not None:
        raise defect
    if ended is None or ended.outcome.state is not RunState.COMPLETE or interrupter.world.collisions:
        raise RuntimeError(f"the uninterrupted run did not complete: {ended and ended.error}")


def _found(interrupter: Interrupter, ended: RunResult | None, defect: BaseException | None) -> dict[str, Any]:
    try:
        return check_interruption(interrupter, ended, defect)
    except BaseException as error:  # noqa: BLE001  as above
        return {"failures": [f"could not be judged: {error!r}"]}


def _carry_out(
    interrupter: Interrupter,
    directory: Path,
    tamper: Callable[[Rig], Rig] = lambda rig: rig,
    **sections: dict[str, Any],
) -> RunResult:
    job = prepare_case(directory, **sections)

    def keep(supervisor: Supervisor) -> None:
        interrupter.supervisor = supervisor

    devices = Devices(
        lambda _, clock, __: tamper(interrupter.rig(build_rig(interrupter.world, clock, job))),
        lambda _: interrupter.clock,
    )
    hooks = RunHooks(attach=keep, devices=devices, write_files=False, answers=interrupter.answers)
    return carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks)


class InvertedStore:
    """Store of a controller that subtracts the corrections of a table instead of adding them, and reads back what was
    written."""

    def __init__(self, store: CompensationStore) -> None:
        self._store = store

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)

    def stage(self, bank: int, table: TableImage) -> None:
        self._store.stage(bank, _negative(table))

    def read_table(self, bank: int) -> TableImage | None:
        held = self._store.read_table(bank)
        return held if held is None or bank == FORMER_BANK else _negative(held)


def _negative(table: TableImage) -> TableImage:
    return replace(table, counts=-table.counts)


def _inverted(rig: Rig) -> Rig:
    store: Any = InvertedStore(rig.store)
    return replace(rig, store=store)


ENDS: dict[str, tuple[Callable[[Rig], Rig], dict[str, dict[str, Any]], RunState]] = {
    "a gate stays closed": (lambda rig: rig, {"gates": {"max_chi2": 1e-6}}, RunState.REFUSED),
    "no proof is possible": (lambda rig: rig, {"verification": {"max_chi2": 1e-6}}, RunState.REFUSED),
    "the proof fails": (_inverted, {}, RunState.COMPLETE),
}


def check_refused_and_restored() -> dict[str, Any]:
    """Carry out three uninterrupted runs that must end with the former table active, and return the failures.

    In the first run a gate refuses the new table, in the second one no proof is possible. In the third run the
    controller applies the table with the wrong sign, the proof fails, and the former table is restored.
    """
    failed = []
    for name, (tamper, sections, state) in ENDS.items():
        with _case(lambda *_: False) as (interrupter, directory):
            ended = _carry_out(interrupter, directory, tamper, **sections)
            controller = interrupter.world.controller
            kept = controller.active_bank == FORMER_BANK and controller.banks[FORMER_BANK].same_as(FORMER_TABLE)
            if ended.outcome.state is not state or not kept or interrupter.world.collisions:
                failed.append(
                    f"{name}: ended {ended.outcome.state.value}, bank {controller.active_bank}: {ended.error}"
                )
    return {"ends": len(ENDS), "ends_failed": failed}


def check_interruption(
    interrupter: Interrupter, ended: RunResult | None, defect: BaseException | None
) -> dict[str, Any]:
    """Check the conditions that must hold after a run has been interrupted, and return an object with up to three keys.

    `ended` is the result of the run, or None if it raised the exception `defect`.

    ``failures`` lists the violated conditions. ``completed`` is True if the run completed before the interruption was
    noticed. ``active`` is the number of the controller's active bank; the key is present only if the run did not
    complete.
    """
    interruption, world = interrupter.interruption, interrupter.world
    assert interruption is not None
    world.advance_to(world.now + SETTLE_S)
    if ended is not None and ended.outcome.state is RunState.COMPLETE:
        return {"completed": True, "failures": [str(c) for c in world.collisions]}
    failures = [*_machine(interrupter), *_compensation(interrupter, ended)]
    if (defect is not None) != (interruption.how == "defect"):
        failures.append(f"raised {defect!r}")
    if interruption.how != "disk full":
        failures += _journal(interrupter)
    if ended is not None:
        expected = RunState.ABORTED if interruption.how in BY_REQUEST else RunState.FAULTED
        if ended.outcome.state is not expected:
            failures.append(f"ended {ended.outcome.state.value}: {ended.error}")
        if EXPECTED_REASONS[interruption.how] not in str(ended.error):
            failures.append(f"the first cause is not reported: {ended.error}")
    return {"completed": False, "failures": failures, "active": world.controller.active_bank}


def _machine(interrupter: Interrupter) -> list[str]:
    world, interruption = interrupter.world, interrupter.interruption
    assert interruption is not None
    failures = [f"collision: {one.body_a} with {one.body_b}" for one in world.collisions]
    if world.controller.motion not in (MotionState.IDLE, MotionState.FAULT):
        failures.append(f"left {world.controller.motion.value}")
    away = abs(float(world.controller.displayed_position()[1]) - world.controller.limits().lower_mm[1])
    if interruption.how in WITHDRAWING and away > POSITION_TOLERANCE_MM and interrupter.ordinal > 1:
        failures.append(f"the axes stand {away:.1f} mm short of the retreat plane")
    return failures


def _compensation(interrupter: Interrupter, ended: RunResult | None) -> list[str]:
    """Return failures unless the former table is active and unchanged.

    After a link loss it cannot be restored; the run must then have reported this.
    """
    controller, interruption = interrupter.world.controller, interrupter.interruption
    assert interruption is not None
    failures = []
    if FORMER_BANK not in controller.banks or not controller.banks[FORMER_BANK].same_as(FORMER_TABLE):
        failures.append("the former table is not what it was")
    if controller.active_bank != FORMER_BANK:
        told = any("could not be made active again" in str(run.reason) for run in interrupter.memory.journal.runs())
        if interruption.how != "link" or not told:
            failures.append(f"bank {controller.active_bank} is active, reported: {told}")
        if controller.active_bank not in controller.banks:
            failures.append("the active bank is empty")
    return failures


def _journal(interrupter: Interrupter) -> list[str]:
    """Return failures unless the journal is closed with the expected final state and gives the first cause as the
    reason.
    """
    interruption, journal = interrupter.interruption, interrupter.memory.journal
    assert interruption is not None
    [run] = journal.runs()
    expected = "aborted" if interruption.how in BY_REQUEST else "faulted"
    states = [event.record["state"] for event in journal.events(run.run, ("state",))]
    failures = []
    if run.state != expected or run.ended is None:
        failures.append(f"the journal ends {run.state}, closed {run.ended}, wanted {expected}")
    if states[-1:] != [expected]:
        failures.append(f"the last state in the journal is {states[-1:]}")
    if EXPECTED_REASONS[interruption.how] not in str(run.reason).split(";", maxsplit=1)[0]:
        failures.append(f"the journal's first cause is {run.reason}")
    faults = [event.record for event in journal.events(run.run, ("fault",))]
    if interruption.how == "defect" and not any(DEFECT in fault["error"] for fault in faults):
        failures.append(f"the journal does not say which defect it was: {faults}")
    return failures
