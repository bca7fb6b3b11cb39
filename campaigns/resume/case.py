"""A short run that breaks off: one machine in this process, and a fuse that ends everything at one instant of one step.

A process that is killed runs nothing any more. Here journal, clock and devices are dead from the fuse on: whatever the
run's own ways out try comes to nothing, as if there were no process.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import agent.runs.kinds.calibrate
from agent.execution.device_assembly import Devices
from agent.execution.encoding import table_digest
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.execution.steps import Step
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job, prepare_job
from agent.planning.preflight import run_preflight, unwatched
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.resume.resume import resume
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.settings.schema import Settings
from drivers.clock import Clock, VirtualClock
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import ScenarioDocument, build_scenario
from simulators.world.world import World

MOMENTS = ("before", "begun", "midway", "done", "durable")
"""Before the step is in the journal; in it, before anything is done; in the middle of its motion; done, its result not
durable; durable."""

STATE = Path("state")
"""Relative on purpose: a copy of the directory is gone on with by changing into it."""

BALLS = (0, 2, 5, 8, 10)


class Killed(BaseException):
    """Nothing runs any more."""


class Fuse:
    """Alive until `burn`; `tell` hears of every instant of every step of the procedure before it passes."""

    def __init__(self, tell: Callable[[str, Step], None]) -> None:
        self.dead = False
        self.midway = False
        self.tell = tell

    def burn(self) -> None:
        self.dead = True
        raise Killed

    def check(self) -> None:
        if self.dead:
            raise Killed


@dataclass
class FusedClock:
    """The clock of one process on a machine that outlives it."""

    inner: Clock
    world: World
    fuse: Fuse | None

    def __post_init__(self) -> None:
        self._ahead_s = self.world.now - self.inner.now()

    def now(self) -> float:
        return self.inner.now() + self._ahead_s

    def sleep(self, duration_s: float) -> None:
        fuse = self.fuse
        if fuse is not None and fuse.midway:
            self.inner.sleep(0.5 * duration_s)
            self.world.advance_to(self.now())
            fuse.burn()
        self.inner.sleep(duration_s)


class FusedDevice:
    def __init__(self, device: SimulatedMachineDevice, fuse: Fuse) -> None:
        self._device, self._fuse = device, fuse

    def __getattr__(self, name: str) -> Any:
        self._fuse.check()
        return getattr(self._device, name)


def fused_journal(fuse: Fuse) -> Callable[[], None]:
    """Every journal of this process tells the `fuse` of its steps; returns what takes that away again."""
    begin, finish, execute = RunJournal.begin, RunJournal.finish, RunJournal._execute

    def fused_begin(self: RunJournal, step: Step) -> None:
        fuse.tell("before", step)
        begin(self, step)
        fuse.tell("begun", step)
        fuse.tell("midway", step)

    def fused_finish(self: RunJournal, step: Step, result: object, *, begun: bool) -> None:
        fuse.tell("done" if begun else "before", step)
        finish(self, step, result, begun=begun)
        fuse.tell("durable", step)

    def fused_execute(self: RunJournal, statement: str, values: Any = ()) -> Any:
        fuse.check()
        return execute(self, statement, values)

    RunJournal.begin, RunJournal.finish = fused_begin, fused_finish  # type: ignore[method-assign]
    RunJournal._execute = fused_execute  # type: ignore[method-assign]

    def unfuse() -> None:
        RunJournal.begin, RunJournal.finish = begin, finish  # type: ignore[method-assign]
        RunJournal._execute = execute  # type: ignore[method-assign]

    return unfuse


def cache_preflight() -> None:
    """Cache the preflight of one case, which is the same every time; copies of this process inherit it."""
    done: dict[Any, Any] = {}

    def once(job: Job, start_mm: Any = None, procedure: Any = None, watch: Any = unwatched) -> Any:
        if start_mm not in done:
            done[start_mm] = run_preflight(job, start_mm, procedure, watch)
        return done[start_mm]

    agent.runs.kinds.calibrate.run_preflight = once  # type: ignore[attr-defined]


@dataclass
class Machine:
    """One machine, and the runs of one state directory on it."""

    world: World

    def run(self, settings: Settings, fuse: Fuse | None = None) -> RunResult:
        job = prepare_job(settings, Path.cwd())
        return carry_out(job, FullCalibration(), Path.cwd(), self._hooks(fuse), run_id="run")

    def resume(self) -> RunResult:
        return resume(STATE, self._hooks(None))

    def _hooks(self, fuse: Fuse | None) -> RunHooks:
        return RunHooks(devices=Devices(self._rig(fuse), lambda _: VirtualClock()), write_files=False)

    @property
    def table(self) -> list[int]:
        """Bank that acts, and CRC-32 of what is in it."""
        controller = self.world.controller
        bank = controller.active_bank
        return [bank, table_digest(controller.banks[bank]) if bank else 0]

    def _rig(self, fuse: Fuse | None) -> Callable[[Settings, Clock, Path], Rig]:
        def assembled(settings: Settings, clock: Clock, _: Path) -> Rig:
            own = FusedClock(clock, self.world, fuse)
            device: Any = SimulatedMachineDevice(self.world, own)
            if fuse is not None:
                device = FusedDevice(device, fuse)
            mounts = {1: device}
            return Rig({"twin": device}, device, device, mounts, device, device, device, clock)

        return assembled


def prepare(directory: Path) -> tuple[Settings, Machine]:
    """Files of a small case in `directory`, which is the working directory: five balls, two positions, one held out; a
    machine so bad, and gates so wide, that the table is written and proved."""
    artefact = (SHIPPED_CONFIGURATION / "artefacts" / "ball-bar-1500.toml").read_text()
    head, rows = artefact.split("balls = [\n")
    lines = rows.splitlines()
    (directory / "bar.toml").write_text(head + "balls = [\n" + "\n".join(lines[ball] for ball in BALLS) + "\n]\n")
    (directory / "positions.csv").write_text("station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n")
    machine = str(SHIPPED_CONFIGURATION / "machines" / "case-study.toml")
    scenario = {
        "machine": machine,
        "artefact": "bar.toml",
        "noise_by_step": True,
        "stations_mm": [[700.0, 1000.0, 750.0]],
        "mount": {"shaft_mm": 120.0},
        "truth": {"scale": 12.0},
        "temperatures": {"artefact_c": 20.5, "machine_c": 21.0, "ambient_c": 20.8},
    }
    roles = ("machine", "probe", "store", "thermometer", "operator", "mount")
    document = {
        "machine": machine,
        "artefact": str(directory / "bar.toml"),
        "state_directory": str(STATE),
        "devices": {"twin": {"driver": "simulated", "options": scenario}},
        "roles": dict.fromkeys(roles, "twin"),
        "stations": {"places_mm": scenario["stations_mm"], "standing_at": 1},
        "probe_check": {"limit_um": 3.0, "touches": 5},
        "procedure": {"position_set": str(directory / "positions.csv"), "stations": [1]},
        "verification": {
            "stations": [1],
            "positions_deg": [[20.0, 25.0]],
            "max_remaining_fraction": 1.0,
            "max_chi2": 1e3,
        },
        "gates": {
            "min_degrees_of_freedom": 1,
            "max_remaining_fraction": 1.0,
            "max_chi2": 1e3,
            "allow_extrapolation": True,
        },
        "table": {"step_mm": [500.0, 325.0, 500.0]},
    }
    world = World(build_scenario(ScenarioDocument.model_validate(scenario), directory))
    return Settings.model_validate(document), Machine(world)


def signature(machine: Machine) -> dict[str, Any]:
    """What must be the same whether or not a run was interrupted: every figure with all its digits."""
    with open_journal(STATE) as reader:
        [row] = reader.runs()
        run = row.run
        [estimate] = reader.estimates(run)
        document = json.loads(estimate)
        document.pop("provenance")
        balls = [dict(ball.record) for ball in reader.balls(run)]
        for ball in balls:
            ball.pop("instant_s", None)
        decisions = reader.decisions(run, procedure_only=True)
        return {
            "state": row.state,
            "estimate": document,
            "balls": balls,
            "touches": [(touch.key, touch.result_text) for touch in reader.touches(run)],
            "table": machine.table,
            "tables": [(one.role, one.bank, one.crc32) for one in reader.tables(run, procedure_only=True)],
            "gates": [(one.kind, one.record_text) for one in decisions if one.kind != "outcome"],
        }


def _nobody(*_: Any) -> None:
    """Nobody listens."""
