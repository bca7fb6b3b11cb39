"""Execution of the undisturbed run, and of copies of it that are disturbed at random instants; judgement of each."""

from __future__ import annotations

import gc
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from agent.execution.device_assembly import Devices
from agent.execution.journal_reader import JournalReader
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from campaigns.aborts.case import InMemoryDatabase, prepare_case
from campaigns.aborts.forked_copies import Forks
from campaigns.grbl.disturbance_kinds import BRAKED_AFTER_S, END_REASON, KINDS, Observation, disturb
from campaigns.grbl.scene import DisturbedMachine
from drivers.roles import MotionState
from drivers.serial_cnc.bank_files import BankFiles

SETTLE_S = 60.0
"""Time in s after the end of the run, longer than any motion of it."""
MOVED_MM = 1e-6
HOLD = b"!"
RESET = "reset"
"""A reset of a controller at rest keeps the position, and the run may go on."""
CHILD_TIMEOUT_S = 600.0
"""Wall time in s for a copy on a busy computer: it may identify the whole machine."""


@dataclass(frozen=True)
class Trial:
    """One undisturbed run and its disturbed copies, at random instants `mean_s` seconds of machine time apart.

    After `most` copies no further one is made.
    """

    dialect: str
    seed: int
    mean_s: float
    most: int


@dataclass
class Disturber:
    """Object that forks a copy of the process at random instants and disturbs the run in the copy."""

    trial: Trial
    scene: DisturbedMachine
    rng: Random
    forks: Forks = field(default_factory=lambda: Forks(CHILD_TIMEOUT_S))
    results: list[dict[str, Any]] = field(default_factory=list)
    seen: Observation | None = None
    deck: list[str] = field(default_factory=list)

    def arrange(self) -> None:
        """Arrange the next disturbance."""
        if len(self.results) < self.trial.most:
            self.scene.clock.at(self.scene.clock.now() + self.rng.expovariate(1.0 / self.trial.mean_s), self._fork)

    def _fork(self) -> None:
        if not self.deck:
            self.deck = list(KINDS)
            self.rng.shuffle(self.deck)
        kind, seed = self.deck.pop(), self.rng.randrange(2**32)
        result = self.forks.fork()
        if result is None:
            self._use_own_banks()
            self.seen = disturb(self.scene, kind, Random(seed))  # noqa: S311  no secret
            return
        self.results.append({**result, "kind": kind, "at_s": round(self.scene.clock.now(), 3)})
        self.arrange()

    def _use_own_banks(self) -> None:
        """Let the copy write to its own files."""
        assert self.scene.probe is not None
        own = Path(tempfile.mkdtemp(dir=self.scene.banks.parent))
        if self.scene.banks.exists():
            shutil.copytree(self.scene.banks, own, dirs_exist_ok=True)
        self.scene.probe.write_banks_to(own)


def run_disturbed(trial: Trial) -> dict[str, Any]:
    """Carry out one run and its disturbed copies. Return their results and the true errors before and after."""
    with _memory() as (memory, directory):
        scene = DisturbedMachine(trial.dialect, directory / "banks")
        disturber = Disturber(trial, scene, Random(trial.seed))  # noqa: S311  no secret
        gc.freeze()
        ended, defect = _carry_out(disturber, directory)
        if disturber.forks.is_child:
            disturber.forks.send_and_exit(_judged(disturber, ended, defect, memory))
        if defect is not None:
            raise defect
        if ended is None or ended.outcome.state is not RunState.COMPLETE or scene.world.collisions:
            raise RuntimeError(f"the undisturbed run did not complete: {ended and ended.error}")
        return {"results": disturber.results, **_true_errors(scene), "machine_s": round(scene.clock.now(), 1)}


def _judged(
    disturber: Disturber, ended: RunResult | None, defect: BaseException | None, memory: InMemoryDatabase
) -> dict[str, Any]:
    try:
        assert disturber.seen is not None
        return judge(disturber.scene, disturber.seen, ended, defect, memory.journal)
    except BaseException as error:  # noqa: BLE001  a child must never continue as its parent
        return {"failures": [f"could not be judged: {error!r}"]}


def _carry_out(disturber: Disturber, directory: Path) -> tuple[RunResult | None, BaseException | None]:
    job = prepare_case(directory)
    scene = disturber.scene

    def keep(supervisor: Supervisor) -> None:
        scene.supervisor = supervisor
        disturber.arrange()

    devices = Devices(lambda _, clock, __: scene.rig(clock, job), lambda _: scene.clock)
    hooks = RunHooks(attach=keep, devices=devices, write_files=False)
    try:
        return carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks), None
    except BaseException as error:  # noqa: BLE001  a child must never continue as its parent
        return None, error


def _true_errors(scene: DisturbedMachine) -> dict[str, Any]:
    """Return the true volumetric errors in µm without and with the table that the driver's files say is active."""
    bank, _ = BankFiles(scene.banks, {}).active()
    table = BankFiles(scene.banks, {}).read(bank) if bank else None
    world = scene.world
    before_um = world.truth.true_volumetric_error()[1]
    if table is None:
        return {"table_bank": bank, "true_ve_before_um": round(before_um, 3), "true_ve_after_um": None}
    world.controller.write_bank(bank, table)
    after_um = world.truth.true_volumetric_error(bank)[1]
    return {
        "table_bank": bank,
        "true_ve_before_um": round(before_um, 3),
        "true_ve_after_um": round(after_um, 3),
    }


@contextmanager
def _memory() -> Iterator[tuple[InMemoryDatabase, Path]]:
    memory = InMemoryDatabase.replace_files()
    with tempfile.TemporaryDirectory(prefix="volcal-grbl-") as name:
        try:
            yield memory, Path(name)
        finally:
            memory.restore_files()


def judge(
    scene: DisturbedMachine,
    seen: Observation,
    ended: RunResult | None,
    defect: BaseException | None,
    journal: JournalReader,
) -> dict[str, Any]:
    """Return the result of one disturbed run; ``failures`` lists the conditions that it violates."""
    kind = KINDS[seen.kind]
    ended_s = scene.clock.now()
    scene.clock.advance_to(ended_s + BRAKED_AFTER_S)
    at_end, place = scene.world.controller.motion, scene.position
    scene.clock.advance_to(ended_s + SETTLE_S)
    after = scene.position
    scene.clock.advance_to(ended_s + 2.0 * SETTLE_S)
    if defect is not None or ended is None:
        return {"failures": [f"raised {defect!r}"]}
    reason = str(ended.error)
    state = ended.outcome.state
    noticed = END_REASON not in reason and state is not RunState.COMPLETE
    failures = [f"collision: {one.body_a} with {one.body_b}" for one in scene.world.collisions]
    if np.abs(scene.position - after).max() > MOVED_MM:
        failures.append("something still moves long after the end of the run")
    if kind.reachable and (at_end is MotionState.MOVING or np.abs(after - place).max() > MOVED_MM):
        failures.append(f"the axes move after the end of the run ({at_end.value})")
    stands = kind.stands and (seen.moving or seen.kind != RESET)
    if stands and seen.braked and seen.released and np.abs(np.subtract(seen.braked, seen.released)).max() > MOVED_MM:
        failures.append("the axes have moved while they must not")
    failures += _reason(seen, state, reason, noticed=noticed)
    if noticed and seen.moving and state is RunState.FAULTED:
        failures += _stop_sent(scene, seen, reachable=kind.reachable)
    [run] = journal.runs()
    lost = (scene.probe.touches if scene.probe else 0) - journal.count_touches(run.run)
    if lost > 0:
        failures.append(f"{lost} measured touches are not in the journal")
    if run.ended is None or run.state != state.value:
        failures.append(f"the journal ends {run.state}, closed {run.ended}")
    return {
        "failures": failures,
        "state": state.value,
        "noticed": noticed,
        "moving": seen.moving,
        "latency_s": round(ended_s - seen.began_s, 3),
        "reason": reason,
    }


def _reason(seen: Observation, state: RunState, reason: str, *, noticed: bool) -> list[str]:
    kind = KINDS[seen.kind]
    if not noticed:
        must = kind.ends_motion and seen.moving
        expected = state in (RunState.ABORTED, RunState.COMPLETE)
        return [f"not noticed: ended {state.value}"] if must or not expected else []
    failures = []
    if state not in (RunState.FAULTED, RunState.ABORTED):
        failures.append(f"ended {state.value}: {reason}")
    if not any(word in reason for word in kind.reasons):
        failures.append(f"the cause is not named: {reason}")
    return failures


def _stop_sent(scene: DisturbedMachine, seen: Observation, *, reachable: bool) -> list[str]:
    """Return a failure unless a feed hold was sent after the disturbance, or could not be and this was noticed."""
    if any(HOLD in data for at_s, data in scene.cable.sent if at_s >= seen.began_s):
        return []
    if not reachable and any(at_s >= seen.began_s for at_s in scene.cable.refused_urgent):
        return []
    return ["no stop was sent"]
