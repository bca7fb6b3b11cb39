"""Short run on one simulated machine in this process, with a kill switch that interrupts the run.

A killed process executes nothing. To simulate this, every access to the journal or to a device fails after the kill
switch has been used. The withdrawal of the probe and the clean-up of the interrupted run therefore have no effect.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import agent.results.estimation
import agent.runs.planned_run
from agent.execution.device_assembly import Devices
from agent.execution.encoding import table_digest
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.execution.steps import Step
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.preflight import never_interrupted, run_preflight
from agent.results.estimation import EstimationResult, estimate_for_job
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.planned_run import Kind
from agent.runs.resume.resume import resume
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.settings.schema import Settings
from campaigns.aborts.case import LENIENT, POSITIONS
from drivers.clock import Clock, VirtualClock
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import ScenarioDocument, build_scenario
from simulators.world.world import World
from twin.artefact.observations import Observations
from twin.identification.options import Options

MOMENTS = ("before", "begun", "midway", "done", "durable")
"""Instants of a step at which the run may be killed.

They occur in this order. At ``before`` the step is not yet in the journal; at ``begun`` it is in the journal, but has
not started; at ``midway`` it is in the middle of its motion; at ``done`` it is complete, but its result is not durable;
at ``durable`` its result is durable.
"""

STATE = Path("state")
"""State directory. The path is relative, so that a process resumes a copied state by changing the working directory."""


CALIBRATION = FullCalibration()


class Killed(BaseException):
    """Error raised by every operation that a killed process would no longer execute."""


class KillSwitch:
    """Switch that simulates the kill of a process. After `kill` has been called, every call of `check` raises Killed.

    The function `notify` is called at each instant in `MOMENTS` (from before a step until its result is durable) of
    every step.
    """

    def __init__(self, notify: Callable[[str, Step], None]) -> None:
        self.dead = False
        self.midway = False
        self.notify = notify

    def kill(self) -> None:
        self.dead = True
        raise Killed

    def check(self) -> None:
        if self.dead:
            raise Killed


@dataclass
class KillableClock:
    """Clock of one agent process on a simulated machine, with a switch that simulates the kill of the process.

    The machine outlives the process. The clock therefore starts at the present time of the machine. If
    `kill_switch.midway` is True, `sleep` kills the run after half of the sleeping time.
    """

    inner: Clock
    world: World
    kill_switch: KillSwitch | None

    def __post_init__(self) -> None:
        self._ahead_s = self.world.now - self.inner.now()

    def now(self) -> float:
        return self.inner.now() + self._ahead_s

    def sleep(self, duration_s: float) -> None:
        kill_switch = self.kill_switch
        if kill_switch is not None and kill_switch.midway:
            self.inner.sleep(0.5 * duration_s)
            self.world.advance_to(self.now())
            kill_switch.kill()
        self.inner.sleep(duration_s)


class KillableDevice:
    def __init__(self, device: SimulatedMachineDevice, kill_switch: KillSwitch) -> None:
        self._device, self._kill_switch = device, kill_switch

    def __getattr__(self, name: str) -> Any:
        self._kill_switch.check()
        return getattr(self._device, name)


def patch_journal(kill_switch: KillSwitch) -> Callable[[], None]:
    """Make every journal of this process call `kill_switch.notify` at each instant of a step at which the run may be
    killed.

    Returns a function that removes this change.
    """
    begin, finish, execute = RunJournal.begin, RunJournal.finish, RunJournal._execute

    def patched_begin(self: RunJournal, step: Step) -> None:
        kill_switch.notify("before", step)
        begin(self, step)
        kill_switch.notify("begun", step)
        kill_switch.notify("midway", step)

    def patched_finish(self: RunJournal, step: Step, result: object, *, begun: bool) -> None:
        kill_switch.notify("done" if begun else "before", step)
        finish(self, step, result, begun=begun)
        kill_switch.notify("durable", step)

    def patched_execute(self: RunJournal, statement: str, values: Any = ()) -> Any:
        kill_switch.check()
        return execute(self, statement, values)

    RunJournal.begin, RunJournal.finish = patched_begin, patched_finish  # type: ignore[method-assign]
    RunJournal._execute = patched_execute  # type: ignore[method-assign]

    def restore() -> None:
        RunJournal.begin, RunJournal.finish = begin, finish  # type: ignore[method-assign]
        RunJournal._execute = execute  # type: ignore[method-assign]

    return restore


def cache_preflight() -> None:
    """Cache the result of the preflight for each start position, because this result does not change in the trial.

    Forked copies of the process inherit the cached result.
    """
    done: dict[Any, Any] = {}

    def once(job: Job, plan_of: Any, start_mm: Any = None, watch: Any = never_interrupted, **how: Any) -> Any:
        if start_mm not in done:
            done[start_mm] = run_preflight(job, plan_of, start_mm, watch, **how)
        return done[start_mm]

    agent.runs.planned_run.run_preflight = once  # type: ignore[attr-defined]


def cache_estimates() -> None:
    """Cache the estimates of a trial by the measurements from which they are made and by what the estimate takes from
    the job: all runs of one job that measure the same have the same estimate, which is not what the trial is about.

    An estimator whose result were not the same each time would therefore stay unseen in the trial. Forked copies of the
    process inherit the cached results. A further call begins with an empty cache.
    """
    done: dict[bytes, EstimationResult] = {}

    def once(job: Job, observations: Observations, options: Options) -> EstimationResult:
        key = pickle.dumps((_estimated_with(job), observations, options))
        if key not in done:
            done[key] = estimate_for_job(job, observations, options)
        return done[key]

    agent.results.estimation.estimate_for_job = once


def _estimated_with(job: Job) -> tuple[object, ...]:
    """Return what an estimate depends on besides the measurements and the options: the machine, the artefact and some
    sections of the settings. Two jobs with the same files in different directories have the same."""
    settings = job.settings
    sections = (settings.temperature, settings.table, settings.identification)
    return (job.machine, job.artefact, settings.tool, *sections)


@dataclass
class ResumeMachine:
    """One simulated machine, and the runs of the agent on it with one state directory."""

    world: World

    def run(self, settings: Settings, kill_switch: KillSwitch | None = None, kind: Kind = CALIBRATION) -> RunResult:
        job = prepare_job(settings, Path.cwd())
        return carry_out(job, kind, Path.cwd(), self._hooks(kill_switch), run_id="run")

    def resume(self) -> RunResult:
        return resume(STATE, self._hooks(None))

    def _hooks(self, kill_switch: KillSwitch | None) -> RunHooks:
        return RunHooks(devices=Devices(self._rig(kill_switch), lambda _: VirtualClock()), write_files=False)

    @property
    def table(self) -> list[int]:
        """Number of the controller's active bank, and CRC-32 of the compensation table in this bank (0 if no table is
        active).
        """
        controller = self.world.controller
        bank = controller.active_bank
        return [bank, table_digest(controller.banks[bank]) if bank else 0]

    def _rig(self, kill_switch: KillSwitch | None) -> Callable[[Settings, Clock, Path], Rig]:
        def assembled(settings: Settings, clock: Clock, _: Path) -> Rig:
            own = KillableClock(clock, self.world, kill_switch)
            device: Any = SimulatedMachineDevice(self.world, own)
            if kill_switch is not None:
                device = KillableDevice(device, kill_switch)
            mounts = {1: device}
            return Rig({"twin": device}, device, device, mounts, device, device, device, clock)

        return assembled


def prepare_case(directory: Path, order: int = 5) -> tuple[Settings, ResumeMachine]:
    """Write the files of a small case to `directory`, which must be the working directory; return the settings and the
    simulated machine. `order` is the order of the Legendre series that are estimated.

    The case has three measured positions and one held-out position. The machine's errors are so large and the
    limits (gates) for a new compensation table so wide that the table is always written and verified.
    """
    (directory / "positions.csv").write_text(POSITIONS)
    machine = str(SHIPPED_CONFIGURATION / "machines" / "case-study.toml")
    artefact = str(SHIPPED_CONFIGURATION / "artefacts" / "ball-bar-1500.toml")
    scenario = {
        "machine": machine,
        "artefact": artefact,
        "noise_by_step": True,
        "stations_mm": [[700.0, 1000.0, 750.0]],
        "mount": {"shaft_mm": 120.0},
        "truth": {"scale": 10.0},
        "temperatures": {"artefact_c": 20.5, "machine_c": 21.0, "ambient_c": 20.8},
    }
    roles = ("machine", "probe", "store", "thermometer", "operator", "mount")
    document = {
        "machine": machine,
        "artefact": artefact,
        "state_directory": str(STATE),
        "devices": {"twin": {"driver": "simulated", "options": scenario}},
        "roles": dict.fromkeys(roles, "twin"),
        "stations": {"places_mm": scenario["stations_mm"], "standing_at": 1},
        "probe_check": {"limit_um": 3.0, "touches": 5},
        "procedure": {"position_set": str(directory / "positions.csv"), "stations": [1]},
        **LENIENT,
        "identification": {"order": order},
    }
    world = World(build_scenario(ScenarioDocument.model_validate(scenario), directory))
    return Settings.model_validate(document), ResumeMachine(world)


def signature(machine: ResumeMachine) -> dict[str, Any]:
    """Return all results of the run that an interruption must not change. All digits of their numbers are kept."""
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
