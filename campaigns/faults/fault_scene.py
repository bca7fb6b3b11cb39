"""Machine, agent and computer of one night, on which a fault can act."""

from __future__ import annotations

import dataclasses
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.planning.job import Job
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE, SCALE, InMemoryDatabase
from campaigns.faults.faulty_device import DEVICE, FaultyDevice, WatchedClock
from drivers.clock import Clock
from drivers.roles import TableImage
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import read_scenario
from simulators.world.world import World

OTHER_BANK = 3
OTHER_TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 650.0, 750.0), 1e-4, np.full((3, 3, 3, 3), -40, dtype=np.int32))
"""Table of nobody knows whom, in a bank that volcal does not use."""


@dataclass
class FaultScene:
    """World, clock, device and journal of a night, and what a fault has told about itself.

    `size` describes the size of the fault in words. `stopped_s` is the instant of a fault after which the axes must
    stand still, and `aborted_s` that of an abort by request, both in s of machine time. `repairs` are functions that
    remove the fault in the morning.
    """

    world: World
    memory: InMemoryDatabase
    clock: WatchedClock = field(default_factory=WatchedClock)
    device: FaultyDevice | None = None
    supervisor: Supervisor | None = None
    connections: list[sqlite3.Connection] = field(default_factory=list)
    size: str = ""
    stopped_s: float | None = None
    aborted_s: float | None = None
    journal_writable: bool = True
    repairs: list[Callable[[], None]] = field(default_factory=list)

    @property
    def machine(self) -> FaultyDevice:
        """Device of the rig; the rig must have been made."""
        assert self.device is not None
        return self.device

    def rig(self, clock: Clock, job: Job) -> Rig:
        """Return a rig of which one faulty device plays every role."""
        self.device = FaultyDevice(SimulatedMachineDevice(self.world, clock), self.clock)
        # The device sleeps on the interruptible clock of the run, but the world follows the clock below it.
        self.clock.subscribe(self.world.advance_to)
        device: Any = self.device
        mounts = dict.fromkeys(range(1, len(job.settings.stations.places_mm) + 1), device)
        return Rig({DEVICE: device}, device, device, mounts, device, device, device, clock)


def build_world(seed: int) -> World:
    """Return a world with a machine, an artefact and noise drawn with `seed`. A table from an earlier run is active, and
    another bank holds a table that is not volcal's.
    """
    shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
    settings = shipped.settings
    drawn = settings.model_copy(
        update={
            "seed": seed,
            "truth": settings.truth.model_copy(update={"seed": seed, "scale": SCALE}),
            "artefact_truth": settings.artefact_truth.model_copy(update={"seed": seed}),
            "store": settings.store.model_copy(update={"banks": [1, 2, OTHER_BANK]}),
        }
    )
    world = World(dataclasses.replace(shipped, settings=drawn))
    world.controller.write_bank(OTHER_BANK, OTHER_TABLE)
    world.controller.write_bank(FORMER_BANK, FORMER_TABLE)
    world.controller.activate(FORMER_BANK)
    return world
