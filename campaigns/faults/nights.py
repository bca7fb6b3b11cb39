"""Execution of nights with faults: one undisturbed run, of which a copy is forked at the instant of each fault."""

from __future__ import annotations

import gc
import logging
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import structlog

from agent.execution import steps as s
from agent.execution.device_assembly import Devices
from agent.execution.engine import Action
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from benchmarks.places import memory_directory
from campaigns.aborts.case import InMemoryDatabase, prepare_case
from campaigns.aborts.forked_copies import Forks
from campaigns.faults.fault_kinds import KINDS, PlannedFault, plan_fault
from campaigns.faults.fault_scene import FaultScene, behind_proxy, build_world
from campaigns.faults.judgement import EndedNight, record_night
from campaigns.faults.night_record import NightRecord
from campaigns.resume.case import cache_preflight
from drivers.clock import Clock
from simulators.world.world import World

CHILD_TIMEOUT_S = 600.0
"""Wall time in s for a copy on a busy computer: it may identify the whole machine."""


NIGHTS_PER_MACHINE = 50
BANKS_OF_REGISTER_MAP = (1, 2)


@dataclass(frozen=True)
class Share:
    """Nights of one machine: those with the numbers from `first` to before `end`."""

    seed: int
    first: int
    end: int


@dataclass
class FaultInjector:
    """Object that forks a copy of the process at the instant of each planned fault; the fault begins in the copy.

    `duration_s` is the machine time of an undisturbed night. With a single fault and `forked` False, the fault begins
    in this process.
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
    over: bool = False
    """True from the end of the run on: no fault begins any more."""

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
        if self.begun is not None or self.over:
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
        listed: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in result.items()
        }
        return NightRecord(**listed)
    failures = tuple(str(one) for one in result["failures"])
    return NightRecord(fault.seed, fault.night, KINDS[fault.kind].group, fault.kind, round(now_s, 3), failures=failures)


def play_share(share: Share) -> tuple[list[NightRecord], float]:
    """Return the records of the nights of one machine, and the CPU time in s that they took with their copies."""
    # What a driver logs of each disturbed frame is not what the trial reports.
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began_s = _cpu_s()
    faults = [plan_fault(share.seed, night) for night in range(share.first, share.end)]
    machine = machine_seed(share.seed, share.first)
    records = play_nights([one for one in faults if not KINDS[one.kind].proxied], machine)
    for fault in faults:
        if KINDS[fault.kind].proxied:
            records += play_nights([fault], machine, forked=False)
    return sorted(records, key=lambda night: night.night), _cpu_s() - began_s


def machine_seed(seed: int, night: int) -> int:
    """Return the seed of the machine of a night of the campaign with the seed `seed`."""
    return 1000 * seed + night // NIGHTS_PER_MACHINE


def _cpu_s() -> float:
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def play_nights(faults: Sequence[PlannedFault], world_seed: int, *, forked: bool = True) -> list[NightRecord]:
    """Play one night for each of the faults, all on the machine drawn with `world_seed`, and return their records.

    If `forked` is False, `faults` must have one element, and its night is played in this process.
    """
    duration_s = _undisturbed_duration_s()
    proxied = any(KINDS[one.kind].proxied for one in faults)
    world = build_world(world_seed, BANKS_OF_REGISTER_MAP) if proxied else build_world(world_seed)
    with _scene(world) as (scene, directory), behind_proxy(scene) if proxied else nullcontext():
        injector = FaultInjector(scene, faults, duration_s, forked)
        if forked:  # what is alive stays on pages that the copies share
            gc.collect()
            gc.freeze()
        try:
            ended, defect = _carry_out(injector, directory)
            injector.over = True
            record = partial(_record, injector, ended, defect, directory)
            if injector.forks.is_child:
                assert injector.begun is not None
                injector.forks.send_and_exit(asdict(record(injector.begun)))
        except BaseException as error:
            if injector.forks.is_child:  # a copy must never continue as its parent
                injector.forks.send_and_exit({"failures": [f"could not be judged: {error!r}"]})
            raise
        if injector.begun is not None:
            return [record(injector.begun)]
        if forked:
            gc.unfreeze()
        missed = {one.night for one in faults} - {one.night for one in injector.records}
        return [*injector.records, *(record(one, reached=False) for one in faults if one.night in missed)]


def _record(
    injector: FaultInjector,
    ended: RunResult | None,
    defect: BaseException | None,
    directory: Path,
    fault: PlannedFault,
    *,
    reached: bool = True,
) -> NightRecord:
    return record_night(
        EndedNight(injector.scene, fault, ended, defect, injector.began_s, injector.balls, directory, reached)
    )


_duration_s: list[float] = []


def _undisturbed_duration_s() -> float:
    """Return the machine time in s of an undisturbed night, which is played once in a process.

    The preflight is the same in every night and is computed once, too.
    """
    if not _duration_s:
        cache_preflight()
        with _scene(build_world(0)) as (scene, directory):
            ended, defect = _carry_out(FaultInjector(scene, (), 0.0), directory)
            if defect is not None:
                raise defect
            assert ended is not None
            if ended.outcome.proof is None or not ended.outcome.proof.accepted:
                raise RuntimeError(f"the undisturbed night was not accepted: {ended.outcome.reason}")
            _duration_s.append(scene.clock.now())
    return _duration_s[0]


@contextmanager
def _scene(world: World) -> Iterator[tuple[FaultScene, Path]]:
    memory = InMemoryDatabase.replace_files()
    scene = FaultScene(world, memory)
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
