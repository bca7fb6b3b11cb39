"""Machine of the case study behind a simulated GRBL or grblHAL, with the real driver in this process."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from campaigns.aborts.case import build_case_world
from campaigns.grbl.cable import VirtualCable
from campaigns.plans.motion_run import AlarmClock
from drivers.clock import Clock
from drivers.registry import DeviceContext
from drivers.roles import Miss, Touch, Vector
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.settings import SerialCncSettings
from simulators.backend import SimulatedMachineDevice
from simulators.wire.grbl.controller import GrblController
from simulators.wire.grbl.dialect import DIALECTS
from simulators.wire.grbl.settings import GrblSettings
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

MAX_HOLD_S = 30.0


class CountingProbe:
    """Proxy of the serial device that counts the touches it has returned."""

    def __init__(self, device: SerialCnc) -> None:
        self._device = device
        self.touches = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def write_banks_to(self, directory: Path) -> None:
        self._device._store._files.directory = directory

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        touched = self._device.touch_towards(target_mm, feed_mm_per_s=feed_mm_per_s)
        self.touches += isinstance(touched, Touch)
        return touched


class OtherRoles:
    """Proxy of the simulated device in the roles that GRBL does not have. It neither stops nor holds the axes."""

    def __init__(self, device: SimulatedMachineDevice) -> None:
        self._device = device

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def stop(self) -> None:
        """Do nothing, because only the serial line may stop the axes."""

    hold = resume = close = stop


@dataclass
class DisturbedMachine:
    """Simulated machine with its controller, the cable to it, and the clock that moves everything."""

    dialect: str
    banks: Path
    clock: AlarmClock = field(default_factory=AlarmClock)
    world: World = field(default_factory=build_case_world)
    supervisor: Supervisor | None = None

    def __post_init__(self) -> None:
        world = self.world
        world.controller.activate(0)  # the tables are in files, not in this controller
        self.cable = VirtualCable(self.clock)
        shared = SharedWorld(world)
        settings = GrblSettings(world.controller.limits(), dialect=DIALECTS[self.dialect])
        self.controller = GrblController(world.controller, lambda: shared.now, self.cable.hear, settings=settings)
        self.cable.received = self.controller.received
        shared.subscribe(self.controller.on_advance, wakes_at=self.controller.wakes_at)
        shared.subscribe(self.cable.deliver, wakes_at=self.cable.next_arrival_s)
        self.clock.subscribe(shared.advance_to)
        self.probe: CountingProbe | None = None

    @property
    def position(self) -> np.ndarray:
        return np.array(self.world.controller.displayed_position())

    def device(self, clock: Clock) -> SerialCnc:
        options = {
            "port": "virtual",
            "axis_zero_mm": [-value for value in self.world.controller.limits().upper_mm],
            "max_hold_s": MAX_HOLD_S,
            "banks": {"directory": str(self.banks)},
        }
        return SerialCnc(SerialCncSettings.model_validate(options), DeviceContext("cnc", clock, self.banks), self.cable)

    def rig(self, clock: Clock, job: Job) -> Rig:
        self.probe = CountingProbe(self.device(clock))
        others: Any = OtherRoles(SimulatedMachineDevice(self.world, clock))
        cnc: Any = self.probe
        mounts = dict.fromkeys(range(1, len(job.settings.stations.places_mm) + 1), others)
        return Rig(
            devices={"cnc": cnc, "other": others},
            machine=cnc,
            probe=cnc,
            mounts=mounts,
            store=cnc,
            thermometer=others,
            operator=others,
            clock=clock,
        )
