"""Execution of nights with faults: one undisturbed run, of which a copy is forked at the instant of each fault."""

from __future__ import annotations

import contextlib
import gc
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import agent.runs.planned_run
from agent.execution import steps as s
from agent.execution.device_assembly import Devices
from agent.execution.encoding import table_digest
from agent.execution.engine import Action
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.reconcile import reconcile
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from benchmarks.places import memory_directory
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE, InMemoryDatabase, prepare_case
from campaigns.aborts.forked_copies import Forks
from campaigns.faults.fault_kinds import KINDS, PlannedFault
from campaigns.faults.fault_scene import FaultScene, build_world
from campaigns.faults.faulty_device import HangDetectedError, WatchedClock
from campaigns.faults.night_record import NightRecord
from campaigns.resume.case import cache_preflight
from drivers.clock import Clock, VirtualClock
from drivers.errors import UserError, VolcalError

CHILD_TIMEOUT_S = 600.0
"""Wall time in s for a copy on a busy computer: it may identify the whole machine."""
SETTLE_S = 60.0
"""Time in s after the end of the run, longer than any motion of it."""
UNRESTORED = "could not be made active again"


@dataclass
class FaultInjector:
    """Object that forks a copy of the process at the instant of each planned fault, and lets the fault begin in the copy.

    `duration_s` is the machine time of an undisturbed night. With a single fault and `forked` False, the fault begins in
    this process.
    """

    scene: FaultScene
    faults: Sequence[PlannedFault]
    duration_s: float
    forked: bool = True
    forks: Forks = field(default_factory=lambda: Forks(CHILD_TIMEOUT_S))
    records: list[NightRecord] = field(default_factory=list)
    begun: PlannedFault | None = None
    began_s: float = 0.0
    balls: int = 0

    def rig(self, clock: Clock, job: Job) -> Rig:
        """Return the rig of the run. Faults of the evening begin now, the others are arranged."""
        rig = self.scene.rig(clock, job)
        for fault in self.faults:
            if fault.key:
                continue
            if fault.fraction == 0.0:
                self.begin(fault)
            else:
                self.scene.clock.at(fault.fraction * self.duration_s, lambda fault=fault: self.begin(fault))  # type: ignore[misc]
        return rig

    def begin(self, fault: PlannedFault) -> None:
        """Let the fault begin in a copy of this process; in the copy of another fault, do nothing."""
        if self.begun is not None:
            return
        if self.forked:
            result = self.forks.fork()
            if result is not None:
                self.records.append(_received(fault, result, self.scene.clock.now()))
                return
        self.begun, self.began_s = fault, self.scene.clock.now()
        KINDS[fault.kind].apply(self.scene, fault.generator())

    def answers(self, actions: Mapping[type, Action]) -> Mapping[type, Action]:
        """Return `actions` wrapped so that faults can begin before or after a step."""
        return {kind: self._watched(action) for kind, action in actions.items()}

    def _watched(self, action: Action) -> Action:
        def perform(step: s.Step) -> Any:
            self._begin_at(step.key, after=False)
            result = action(step)
            self._begin_at(step.key, after=True)
            return result

        return perform

    def _begin_at(self, key: str, *, after: bool) -> None:
        for fault in self.faults:
            if fault.key == key and fault.after is after:
                self.begin(fault)

    def observe(self, step: s.Step, _: object) -> None:
        """Count the balls that the run has acknowledged."""
        self.balls += isinstance(step, s.Record) and step.kind == "ball"


def _received(fault: PlannedFault, result: Mapping[str, Any], now_s: float) -> NightRecord:
    """Return the record that a copy has sent, or one with the reasons why it has sent none."""
    if "night" in result:
        listed = {name: tuple(value) if isinstance(value, list) else value for name, value in result.items()}
        return NightRecord(**listed)
    failures = tuple(str(one) for one in result["failures"])
    return NightRecord(fault.seed, fault.night, KINDS[fault.kind].group, fault.kind, round(now_s, 3), failures=failures)


def play_nights(faults: Sequence[PlannedFault], world_seed: int, *, forked: bool = True) -> list[NightRecord]:
    """Play one night for each of the faults, all on the machine drawn with `world_seed`, and return their records.

    If `forked` is False, `faults` must have one element, and its night is played in this process.
    """
    duration_s = _undisturbed_duration_s()
    with _scene(world_seed) as (scene, directory):
        injector = FaultInjector(scene, faults, duration_s, forked)
        if forked:
            gc.freeze()
        try:
            ended, defect = _carry_out(injector, directory)
            if injector.forks.is_child:
                injector.forks.send_and_exit(_sent(injector, ended, defect, directory))
        except BaseException as error:
            if injector.forks.is_child:  # a copy must never continue as its parent
                injector.forks.send_and_exit({"failures": [f"could not be judged: {error!r}"]})
            raise
        if injector.begun is not None:
            return [_judged(injector, injector.begun, ended, defect, directory)]
        missed = {one.night for one in faults} - {one.night for one in injector.records}
        unreached = [_unreached(injector, one, ended, defect, directory) for one in faults if one.night in missed]
        return [*injector.records, *unreached]


def _sent(
    injector: FaultInjector, ended: RunResult | None, defect: BaseException | None, directory: Path
) -> dict[str, Any]:
    assert injector.begun is not None
    return asdict(_judged(injector, injector.begun, ended, defect, directory))


def _unreached(
    injector: FaultInjector,
    fault: PlannedFault,
    ended: RunResult | None,
    defect: BaseException | None,
    directory: Path,
) -> NightRecord:
    """Return the record of a night that ended before its fault began."""
    return _judged(injector, fault, ended, defect, directory, reached=False)


_duration_s: list[float] = []


def _undisturbed_duration_s() -> float:
    """Return the machine time in s of an undisturbed night, which is played once in a process. The preflight is the same
    in every night and is computed once, too."""
    if not _duration_s:
        cache_preflight()
        with _scene(0) as (scene, directory):
            ended, defect = _carry_out(FaultInjector(scene, (), 0.0), directory)
            if defect is not None:
                raise defect
            assert ended is not None
            if ended.outcome.proof is None or not ended.outcome.proof.accepted:
                raise RuntimeError(f"the undisturbed night was not accepted: {ended.outcome.reason}")
            _duration_s.append(scene.clock.now())
    return _duration_s[0]


@contextmanager
def _scene(world_seed: int) -> Iterator[tuple[FaultScene, Path]]:
    memory = InMemoryDatabase.replace_files()
    scene = FaultScene(build_world(world_seed), memory)
    connect = sqlite3.connect

    def kept(*values: Any, **options: Any) -> sqlite3.Connection:
        scene.connections.append(connect(*values, **options))
        return scene.connections[-1]

    sqlite3.connect = kept  # type: ignore[assignment]
    with memory_directory("faults") as name:
        try:
            yield scene, Path(name)
        finally:
            memory.restore_files()


def _carry_out(injector: FaultInjector, directory: Path) -> tuple[RunResult | None, BaseException | None]:
    job = prepare_case(directory, stations={"standing_at": 1})
    scene = injector.scene

    def keep(supervisor: Supervisor) -> None:
        scene.supervisor = supervisor

    devices = Devices(lambda _, clock, __: injector.rig(clock, job), lambda _: scene.clock)
    hooks = RunHooks(
        attach=keep, devices=devices, write_files=False, answers=injector.answers, observe=injector.observe
    )
    try:
        return carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks), None
    except BaseException as error:  # noqa: BLE001  a copy must never continue as its parent
        return None, error


def _judged(
    injector: FaultInjector,
    fault: PlannedFault,
    ended: RunResult | None,
    defect: BaseException | None,
    directory: Path,
    *,
    reached: bool = True,
) -> NightRecord:
    """Return the record of the night. The world goes on for some time after the run, and then the fault is removed and
    volcal is started again."""
    scene, world, kind = injector.scene, injector.scene.world, KINDS[fault.kind]
    clock, controller = scene.clock, injector.scene.world.controller
    clock.watched, clock.watch = False, None
    end_s, stood = clock.now(), controller.displayed_position()
    clock.advance_to(end_s + SETTLE_S)
    moved_mm = float(np.abs(controller.displayed_position() - stood).max())
    motion, active = controller.motion.value, controller.active_bank
    device = scene.machine
    acting = _digest(scene, active)
    told, facts = _told(injector, ended, defect)
    before_um = after_um = None
    if acting != table_digest(FORMER_TABLE):
        before_um, after_um = (round(world.truth.true_volumetric_error(bank)[1], 3) for bank in (FORMER_BANK, active))
    former = controller.banks.get(FORMER_BANK)
    return NightRecord(
        seed=fault.seed,
        night=fault.night,
        group=kind.group,
        kind=fault.kind,
        at_s=round(injector.began_s, 3),
        size=" ".join(part for part in (scene.size, fault.key, "after" if fault.after else "") if part),
        reached=reached,
        collisions=tuple(f"{one.body_a} with {one.body_b} at {one.time_s:.2f} s" for one in world.collisions),
        stopped_s=scene.stopped_s,
        stands_from_s=device.moved_until_s,
        moved_after_end_mm=moved_mm,
        motion_at_end=motion,
        former=table_digest(FORMER_TABLE),
        active=acting,
        complete_table=active == 0 or active in controller.banks,
        former_intact=former is not None and former.same_as(FORMER_TABLE),
        written=tuple(table_digest(image) for image in device.staged),
        before_um=before_um,
        after_um=after_um,
        told_unrestored=UNRESTORED in told,
        acknowledged_touches=device.touches,
        acknowledged_balls=injector.balls,
        journal_writable=scene.journal_writable,
        reason=told,
        reasons=kind.reasons,
        hung=clock.hung,
        end_s=round(end_s, 3),
        morning=_morning(scene, directory),
        **facts,
    )


def _told(injector: FaultInjector, ended: RunResult | None, defect: BaseException | None) -> tuple[str, dict[str, Any]]:
    """Return the reason of the end, and what run and journal say of the night."""
    scene = injector.scene
    facts: dict[str, Any] = {}
    reason = ""
    if defect is not None and not isinstance(defect, HangDetectedError):
        facts["raised"] = repr(defect)
    if ended is not None:
        proof, error = ended.outcome.proof, ended.error
        facts |= {"state": ended.outcome.state.value, "accepted": proof is not None and proof.accepted}
        reason = ended.outcome.reason or ("" if proof is None or proof.accepted else proof.reason)
        if isinstance(error, VolcalError):
            facts |= {
                "error": type(error).__name__,
                "user_error": isinstance(error, UserError),
                "step": error.where.get("step", ""),
                "place": error.where.get("device", "") or error.where.get("link", ""),
            }
    journal = scene.memory.journal
    runs = journal.runs()
    if runs:
        run = runs[-1]
        late = [] if scene.aborted_s is None else journal.steps(run.run, procedure_only=True)
        facts |= {
            "journaled_touches": journal.count_touches(run.run),
            "journaled_balls": journal.count_balls(run.run),
            "journal_state": run.state,
            "journal_closed": run.ended is not None,
            "steps_after_abort": tuple(
                step.key
                for step in late
                if scene.aborted_s is not None
                and step.begun_s > scene.aborted_s + ABORT_WITHIN_S
                and step.kind in ACTING
            ),
        }
        reason = str(run.reason) if run.reason and scene.journal_writable else reason
    return reason, facts


ABORT_WITHIN_S = 0.06
"""Machine time in s after which an abort must be in effect: one part of a wait, and rounding."""
ACTING = frozenset(kind.__name__ for kind in s.STEPS_WITH_EFFECT)


def _digest(scene: FaultScene, bank: int) -> int:
    image = scene.world.controller.banks.get(bank)
    return 0 if image is None else table_digest(image)


def _morning(scene: FaultScene, directory: Path) -> int | None:
    """Remove the fault, start volcal again, and return the CRC-32 of the table that acts then; None if the journal holds
    nothing to compare with."""
    scene.machine.repair()
    for repair in scene.repairs:
        with contextlib.suppress(sqlite3.ProgrammingError):  # a connection that was closed meanwhile
            repair()
    scene.world.controller.reset()
    job = prepare_case(directory, stations={"standing_at": 1})
    clock = VirtualClock()
    clock.advance_to(scene.clock.now())
    device: Any = scene.machine._device  # the machine without its fault
    device._clock = clock
    rig = Rig({"twin": device}, device, device, {1: device}, device, device, device, clock)
    rig.open()
    reconcile(rig, directory / "state")
    rig.close()
    return _digest(scene, scene.world.controller.active_bank)
