"""Whole runs in one process: the shipped case study behind the plugin `simulated`, on a virtual clock."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from simulated import SHORT_SET

from agent.errors import GateRefused
from agent.execution.device_assembly import Devices, assemble
from agent.execution.journal_reader import open_journal
from agent.execution.rig import Rig
from agent.execution.run_state import Announcement
from agent.execution.supervisor import Supervisor
from agent.planning.branch_walk import Branch
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.preflight import PreflightResult
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.planned_run import Kind
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.settings.schema import Settings
from campaigns.aborts.case import LENIENT
from campaigns.plans.steps_comparison import walked_branch
from drivers.clock import Clock, VirtualClock
from drivers.roles import TableImage
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import AgeingSettings
from simulators.world.world import World

CONFIG = Path(__file__).resolve().parents[2] / "config"
SCENARIO = CONFIG / "simulators" / "case-study.toml"
PLACES_MM = [[700.0, 1000.0, 750.0], [1567.0, 1000.0, 750.0], [2433.0, 1000.0, 750.0], [3300.0, 1000.0, 750.0]]


def document(state: Path, **sections: Any) -> dict[str, Any]:
    """Settings of the case study with one device in this process; `sections` are merged in, one level deep."""
    roles = ("machine", "probe", "store", "thermometer", "operator", "mount")
    base: dict[str, Any] = {
        "machine": str(CONFIG / "machines" / "case-study.toml"),
        "artefact": str(CONFIG / "artefacts" / "ball-bar-1500.toml"),
        "state_directory": str(state),
        "devices": {
            "twin": {
                "driver": "simulated",
                "options": {"scenario": str(SCENARIO)},
            }
        },
        "roles": dict.fromkeys(roles, "twin"),
        "stations": {"places_mm": PLACES_MM, "standing_at": 1},
        "verification": {"stations": [1, 4]},
        "temperature": {"standard_uncertainty_k": 0.1},
    }
    return merged(base, sections)


def short_document(state: Path, **sections: Any) -> dict[str, Any]:
    """Three positions at one station and one held out; a machine so bad, gates so wide, that all is let through."""
    listed = state.parent / "three-positions.csv"
    listed.write_text(SHORT_SET)
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario |= {name: str(SCENARIO.parent / scenario[name]) for name in ("machine", "artefact")}
    scenario["truth"]["scale"] = 4.0
    short = {
        "devices": {"twin": {"driver": "simulated", "options": scenario}},
        "procedure": {"position_set": str(listed), "stations": [1]},
        **LENIENT,
    }
    return merged(document(state, **short), sections)


def merged(base: dict[str, Any], sections: dict[str, Any]) -> dict[str, Any]:
    """`sections` over `base`, one level deep."""
    result = dict(base)
    for name, values in sections.items():
        result[name] = {**base.get(name, {}), **values} if isinstance(values, dict) else values
    return result


@dataclass
class Night:
    """One machine that may be calibrated again and again; `tamper` is handed the rig before each run."""

    tamper: Callable[[Rig], Rig] = lambda rig: rig
    world: World | None = None
    heard: list[Announcement] = field(default_factory=list)

    def run(
        self,
        settings: dict[str, Any],
        interrupts: Callable[[Supervisor], None] = lambda _: None,
        *,
        files: bool = True,
        kind: Kind | None = None,
    ) -> RunResult:
        """Calibrate, or a run of another `kind`; the world of the first run stays the world of the following ones.
        `files`: write results."""
        job = prepare_job(Settings.model_validate(settings), Path.cwd())
        walked: list[PreflightResult] = []

        def passed(_: Job, preflight: PreflightResult) -> None:
            walked.append(preflight)

        hooks = replace(self.hooks, attach=interrupts, write_files=files, preflight_passed=passed)
        ended = carry_out(job, kind or FullCalibration(), Path.cwd(), hooks)
        if walked and (ended.error is None or isinstance(ended.error, GateRefused)):
            assert_walked(job.settings.state_directory, ended.outcome.run_id, walked[0])
        return ended

    @property
    def hooks(self) -> RunHooks:
        """Hooks of a run on this machine, on virtual time, that writes no files."""

        def assembled(*given: Any) -> Rig:
            return self.tamper(self._with_first_world(assemble(*given)))

        devices = Devices(assembled, lambda _: VirtualClock())
        return RunHooks(announce=self.heard.append, devices=devices, write_files=False)

    def _with_first_world(self, rig: Rig) -> Rig:
        """The machine of the first run, with all that happened to it; its time starts anew with each run's clock."""
        device = rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        if self.world is None:
            self.world = device.world
            return rig
        clock = OffsetClock(rig.clock, self.world.now)
        former = SimulatedMachineDevice(self.world, clock)
        roles: dict[str, Any] = dict.fromkeys(("machine", "probe", "store", "thermometer", "operator"), former)
        mounts = dict.fromkeys(rig.mounts, former)
        return dataclasses.replace(rig, devices={"twin": former}, mounts=mounts, clock=clock, **roles)

    def changed(self, **ageing: Any) -> None:
        """The same machine, bar and banks from now on, with an `ageing` of another night."""
        assert self.world is not None
        former = self.world
        settings = former.scenario.settings
        aged = settings.model_copy(update={"ageing": AgeingSettings(**ageing)})
        self.world = World(dataclasses.replace(former.scenario, settings=aged))
        for bank, image in former.controller.banks.items():
            self.world.controller.write_bank(bank, image)
        self.world.controller.activate(former.controller.active_bank)

    @property
    def banks(self) -> dict[int, TableImage]:
        assert self.world is not None
        return self.world.controller.banks

    @property
    def active(self) -> int:
        assert self.world is not None
        return self.world.controller.active_bank


def assert_walked(state: Path, run_id: str, preflight: PreflightResult) -> None:
    """Assert that the steps that a run has carried out are those of one of the branches that its preflight walked."""
    with open_journal(state) as reader:
        steps = reader.steps(reader.require_run(run_id).run, procedure_only=True)
    found = walked_branch([step.key for step in steps], preflight.ends)
    assert isinstance(found, Branch), f"{found}: no branch has this step there"


@dataclass
class OffsetClock:
    """The clock of a later run on a machine that has seen earlier ones."""

    inner: Clock
    origin_s: float

    def now(self) -> float:
        return self.origin_s + self.inner.now()

    def sleep(self, duration_s: float) -> None:
        self.inner.sleep(duration_s)
