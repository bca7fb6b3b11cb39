"""The run as it is, and the same broken off at its steps."""

from __future__ import annotations

import gc
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution import steps as s
from agent.execution.device_assembly import Devices
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from campaigns.aborts.breaking import Breaking
from campaigns.aborts.case import FORMER, FORMER_BANK, Memory, job_of, world_of
from campaigns.aborts.judging import found
from campaigns.nights.play import rig_of
from campaigns.plans.moving import AlarmClock

MEASURING = ("measure/", "verify/", "probe/")
AROUND = 4
"""So many steps of a measurement before and after one that reads or writes tables are always looked at."""


@dataclass(frozen=True)
class Thinned:
    """Which steps are looked at: of all, those of one `share` of `shares`; every `every`th, and all around tables.

    What is ahead is known from the `keys` of an earlier, unbroken run.
    """

    share: int
    shares: int
    every: int
    keys: Sequence[str]

    def wanted(self, ordinal: int, _: s.Step) -> bool:
        near = self.keys[max(ordinal - 1 - AROUND, 0) : ordinal + AROUND]
        chosen = ordinal % self.every == 0 or any(not key.startswith(MEASURING) for key in near)
        return chosen and ordinal % self.shares == self.share


def unbroken() -> list[str]:
    """Keys of all steps of the run as it is when nothing comes in between; those that act are marked by a ``!``."""
    keys: list[str] = []

    def noted(_: int, step: s.Step) -> bool:
        keys.append(step.key + ("!" if isinstance(step, s.ACTING) else ""))
        return False

    with _case(noted) as (breaking, directory):
        _completed(breaking, directory)
    return keys


def broken_off(thinned: Thinned) -> list[dict[str, Any]]:
    """What the copies of one run that were broken off on its way have left."""
    with _case(thinned.wanted) as (breaking, directory):
        gc.freeze()
        _completed(breaking, directory)
    return breaking.left


@contextmanager
def _case(wanted: Callable[[int, s.Step], bool]) -> Iterator[tuple[Breaking, Path]]:
    memory = Memory.instead_of_files()
    with tempfile.TemporaryDirectory(prefix="volcal-aborts-") as name:
        try:
            yield Breaking(world_of(), AlarmClock(), memory, wanted), Path(name)
        finally:
            memory.end()


def _completed(breaking: Breaking, directory: Path) -> None:
    """Carry the run out. A child of it says what it has found, and is no more; the parent must complete."""
    defect: BaseException | None = None
    ended: RunResult | None = None
    try:
        ended = _carried_out(breaking, directory)
    except BaseException as error:  # noqa: BLE001  a child must not go on as its parent, whatever happens
        defect = error
    if breaking.forks.is_child:
        breaking.forks.leave(_found(breaking, ended, defect))
    if defect is not None:
        raise defect
    if ended is None or ended.outcome.state is not RunState.COMPLETE or breaking.world.collisions:
        raise RuntimeError(f"the run that nobody broke off did not complete: {ended and ended.error}")


def _found(breaking: Breaking, ended: RunResult | None, defect: BaseException | None) -> dict[str, Any]:
    try:
        return found(breaking, ended, defect)
    except BaseException as error:  # noqa: BLE001  as above
        return {"failures": [f"could not be judged: {error!r}"]}


def _carried_out(breaking: Breaking, directory: Path, **sections: dict[str, Any]) -> RunResult:
    job = job_of(directory, **sections)

    def keep(supervisor: Supervisor) -> None:
        breaking.supervisor = supervisor

    devices = Devices(lambda _, clock, __: breaking.rig(rig_of(breaking.world, clock, job)), lambda _: breaking.clock)
    hooks = RunHooks(attach=keep, devices=devices, write_files=False)
    return carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks)


ENDS: dict[str, tuple[dict[str, dict[str, Any]], RunState]] = {
    "a gate stays closed": ({"gates": {"max_chi2": 1e-6}}, RunState.REFUSED),
    "the proof fails": ({"verification": {"max_chi2": 1e-6}}, RunState.COMPLETE),
}


def closed_and_restored() -> dict[str, Any]:
    """The ways out that the run itself takes: nothing is written, or what was written is taken back."""
    failed = []
    for name, (sections, state) in ENDS.items():
        with _case(lambda *_: False) as (breaking, directory):
            ended = _carried_out(breaking, directory, **sections)
            controller = breaking.world.controller
            kept = controller.active_bank == FORMER_BANK and controller.banks[FORMER_BANK].same_as(FORMER)
            if ended.outcome.state is not state or not kept or breaking.world.collisions:
                failed.append(
                    f"{name}: ended {ended.outcome.state.value}, bank {controller.active_bank}: {ended.error}"
                )
    return {"ends": len(ENDS), "ends_failed": failed}
