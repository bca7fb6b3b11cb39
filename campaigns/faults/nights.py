"""Execution of nights with faults: one undisturbed run, of which a copy is forked at the instant of each first
fault.
"""

from __future__ import annotations

import gc
import logging
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import structlog

from agent.execution.device_assembly import Devices
from agent.execution.journal_schema import FILE_NAME
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.resume.resume import resume
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.settings.schema import Settings
from benchmarks.places import memory_directory
from campaigns.aborts.case import FORMER_BANK, InMemoryDatabase, prepare_case
from campaigns.aborts.forked_copies import Forks
from campaigns.faults.fault_injector import FaultInjector
from campaigns.faults.fault_scene import FaultScene, build_world
from campaigns.faults.judgement import EndedRun, Start, record_run, start_volcal
from campaigns.faults.night_record import NightRecord
from campaigns.faults.planned_night import LINKED_EVERY, PlannedNight, plan_night
from campaigns.faults.real_links import CAN_BUSES, linked
from campaigns.resume.case import cache_estimates, cache_preflight
from drivers.clock import Clock
from drivers.errors import VolcalError
from simulators.world.world import World

CHILD_TIMEOUT_S = 600.0
"""Wall time in s for a copy on a busy computer: it may identify the whole machine."""


MakeRig = Callable[[Clock, Settings], Rig]

NIGHTS_PER_MACHINE = 50
BANKS_OF_REGISTER_MAP = (1, 2)
IDENTIFICATION = {"order": 3}
"""A model of a given small order: with one chosen by evidence, a run takes half as much computing time again."""
MOST_DRAWS = 30
LEAST_GAIN = 0.2
"""Share by which the true error must decrease in an undisturbed night."""
NEXT_DRAW = 10**9
"""Distance of the seeds of successive draws of one machine."""


@dataclass(frozen=True)
class NightMachine:
    """Machine of nights. It is drawn with the seed `world_seed`, after `refused` machines whose undisturbed night does
    not end with an accepted table. The instants of the faults are drawn over `undisturbed_s` seconds of machine time,
    the duration of such a night.
    """

    world_seed: int
    undisturbed_s: float
    refused: int = 0


@dataclass(frozen=True)
class PlayedShare:
    """Records of the nights of one machine, and the CPU time in s that they took with their copies."""

    machine: NightMachine
    records: Sequence[NightRecord]
    cpu_s: float


@dataclass(frozen=True)
class Share:
    """Nights of one machine: those with the numbers from `first` to before `end`."""

    seed: int
    first: int
    end: int


def play_share(share: Share) -> PlayedShare:
    """Play the nights of one machine."""
    # What a driver logs of each disturbed frame is not what the trial reports.
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    began_s = cpu_s()
    machine = accepted_machine(share.seed, share.first)
    nights = [plan_night(share.seed, night) for night in range(share.first, share.end)]
    records = play_nights([one for one in nights if not one.link], machine)
    for night in nights:
        if night.link:
            records += play_nights([night], machine, forked=False)
    return PlayedShare(machine, sorted(records, key=lambda night: night.night), cpu_s() - began_s)


def drawn_seed(seed: int, night: int, draw: int = 0) -> int:
    """Return the seed of the draw number `draw` of the machine of a night of the campaign with the seed `seed`."""
    return 1000 * seed + night // NIGHTS_PER_MACHINE + NEXT_DRAW * draw


@cache
def accepted_machine(seed: int, night: int) -> NightMachine:
    """Return the machine of a night of the campaign with the seed `seed`: the first one drawn whose undisturbed night
    ends with an accepted table that makes it better by `LEAST_GAIN` in the whole workspace.

    On another machine no table is written, since a gate refuses it or no proof could show its gain with one held-out
    position, and a fault that begins at a step that writes never would. Or the noise of the touches alone decides
    whether a table from three positions helps far from them, since the gates that ask for more are wide open here. The
    results of the preflight and the estimates are cached for the nights that follow. Raises RuntimeError if no table is
    accepted in `MOST_DRAWS` draws.
    """
    cache_preflight()
    cache_estimates()
    for draw in range(MOST_DRAWS):
        world_seed = drawn_seed(seed, night, draw)
        with _scene(build_world(world_seed)) as (scene, directory):
            run = _carry_out(FaultInjector(scene, (), 0.0, lambda *_: None), directory)
            if run.defect is not None:
                raise run.defect
            assert run.ended is not None
            proof, truth = run.ended.outcome.proof, scene.world.truth
            if proof is None or not proof.accepted:
                continue
            (_, before_um), (_, after_um) = (
                truth.true_volumetric_error(bank) for bank in (FORMER_BANK, scene.world.controller.active_bank)
            )
            if after_um <= (1.0 - LEAST_GAIN) * before_um:
                return NightMachine(world_seed, scene.clock.now(), draw)
    raise RuntimeError(f"no undisturbed night of {MOST_DRAWS} machines was accepted")


def cpu_s() -> float:
    """Return the CPU time in s of this process and of its ended copies."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def play_nights(nights: Sequence[PlannedNight], machine: NightMachine, *, forked: bool = True) -> list[NightRecord]:
    """Play the nights, all on one machine, and return their records.

    All must have the same kind of real link. If `forked` is False, `nights` must have one element, which is played in
    this process.
    """
    link, bus = nights[0].link, CAN_BUSES[nights[0].night // LINKED_EVERY % len(CAN_BUSES)]
    world = build_world(machine.world_seed, *([BANKS_OF_REGISTER_MAP] if link else []))
    records: list[NightRecord] = []
    with _scene(world) as (scene, directory), linked(scene, link, directory, bus):

        def receive(night: PlannedNight, result: Mapping[str, Any]) -> None:
            records.append(received_record(night, result, scene.clock.now()))

        injector = FaultInjector(scene, nights, machine.undisturbed_s, receive, forked, Forks(CHILD_TIMEOUT_S))
        if forked:  # what is alive stays on pages that the copies share
            gc.collect()
            gc.freeze()
        try:
            run = _carry_out(injector, directory)
            if injector.forks.is_child:
                assert injector.night is not None
                injector.forks.send_and_exit(asdict(judge_night(injector.night, run)))
        except BaseException as error:
            if injector.forks.is_child:  # a copy must never continue as its parent
                injector.forks.send_and_exit({"failures": [f"could not be judged: {error!r}"]})
            raise
        if injector.night is not None:
            return [judge_night(injector.night, run)]
        if forked:
            gc.unfreeze()
        missed = {one.night for one in nights} - {one.night for one in records}
        return [*records, *(replace(judge_night(one, run), reached=False) for one in nights if one.night in missed)]


def received_record(night: PlannedNight, result: Mapping[str, Any], now_s: float) -> NightRecord:
    """Return the record that a copy has sent, or one with the reasons why it has sent none."""
    if "night" in result:
        return NightRecord.from_json(result)
    failures = tuple(str(one) for one in result["failures"])
    return NightRecord(night.seed, night.night, night.group, night.kind, round(now_s, 3), failures=failures)


def judge_night(night: PlannedNight, run: EndedRun, make_rig: MakeRig | None = None) -> NightRecord:
    """Return the record of a night after its run: its mornings follow. `make_rig` makes the rig of a resumed run, by
    default that of the injector."""
    record = record_run(run, night)
    injector = run.injector
    for number, morning in enumerate(night.mornings):
        injector.scene.repair()
        if "restart" in morning or morning == "give up":
            how = Start.GIVEN_UP if morning == "give up" else Start.RESTARTED
            record = start_volcal(record, run, how)
        if "resume" not in morning or record.state in ("complete", "refused"):
            continue
        injector.start_again()
        try:
            resumed = _resume(injector, run.directory, make_rig)
        except VolcalError as refusal:
            if not injector.begun:  # a fault of this morning may have caused it
                record = replace(record, resume_refused=str(refusal))
            continue
        rest = replace(night, mornings=night.mornings[number + 1 :])
        return replace(record, later=judge_night(rest, resumed, make_rig))
    return record


@contextmanager
def _scene(world: World) -> Iterator[tuple[FaultScene, Path]]:
    memory = InMemoryDatabase.replace_files()
    scene = FaultScene(world, lambda: memory.journal, memory)
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


def _carry_out(injector: FaultInjector, directory: Path) -> EndedRun:
    job = prepare_case(directory, stations={"standing_at": 1}, identification=IDENTIFICATION)
    hooks = run_hooks(injector)
    ended: RunResult | None = None
    defect: BaseException | None = None
    try:
        ended = carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks)
    except BaseException as error:  # noqa: BLE001  a copy must never continue as its parent
        defect = error
    injector.end_run()
    return EndedRun(injector, ended, defect, directory)


def _resume(injector: FaultInjector, directory: Path, make_rig: MakeRig | None) -> EndedRun:
    """Resume the run as `volcal resume` does. Raises VolcalError if that is refused."""
    (directory / "state" / FILE_NAME).touch()  # the journal itself is in memory
    ended: RunResult | None = None
    defect: BaseException | None = None
    try:
        ended = resume(directory / "state", run_hooks(injector, make_rig))
    except VolcalError:
        raise
    except BaseException as error:  # noqa: BLE001  a copy must never continue as its parent
        defect = error
    finally:
        injector.end_run()
    return EndedRun(injector, ended, defect, directory)


def run_hooks(injector: FaultInjector, make_rig: MakeRig | None = None) -> RunHooks:
    """Return the hooks of a run whose faults `injector` lets begin. `make_rig` makes its rig, by default that of the
    injector."""
    scene = injector.scene

    made = make_rig or injector.rig

    def keep(supervisor: Supervisor) -> None:
        scene.supervisor = supervisor

    return RunHooks(
        attach=keep,
        devices=Devices(lambda settings, clock, _: made(clock, settings), lambda _: scene.clock),
        lock=lambda *_: nullcontext(),  # a copy would share the lock with its parent
        write_files=False,
        answers=injector.answers,
        observe=injector.observe,
    )
