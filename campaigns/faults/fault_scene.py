"""Machine, agent and computer of one night, on which a fault can act."""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.execution.journal_reader import JournalReader
from agent.execution.rig import Rig
from agent.execution.supervisor import Supervisor
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.settings.schema import Settings
from campaigns.aborts.case import FORMER_BANK, FORMER_TABLE, SCALE, InMemoryDatabase
from campaigns.faults.faulty_device import DEVICE, FaultyDevice, WatchedClock
from campaigns.faults.link_proxy import LinkProxy
from drivers.clock import Clock
from drivers.modbus_cnc.device import ModbusCnc
from drivers.roles import TableImage
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import read_scenario
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

OTHER_BANK = 3
OTHER_TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 650.0, 750.0), 1e-4, np.full((3, 3, 3, 3), -40, dtype=np.int32))
"""Table of nobody knows whom, in a bank that volcal does not use."""


@dataclass(frozen=True)
class RigDevices:
    """Devices of a rig. `cnc`, with the name `name`, plays the machine, the probe, the store and the thermometer.

    `other` plays the other roles, and `mount` the mount; where they are None, the device named before plays them.
    """

    name: str
    cnc: SimulatedMachineDevice | ModbusCnc
    other: Any = None
    mount: Any = None
    mount_name: str = ""


def _one_device(simulated: SimulatedMachineDevice, _: Clock) -> RigDevices:
    return RigDevices(DEVICE, simulated)


@dataclass
class FaultScene:
    """World, clock, device and journal of a night, and what a fault has told about itself.

    `journal` opens the journal; `memory` is its database if it is in memory.

    `size` describes the size of the last fault in words. `stopped_s` is the first instant of a fault after which the
    axes must stand still, and `aborted_s` that of an abort by request, both in s of machine time. `repairs` are
    functions that remove the faults in the morning, in the order of the faults. `deceived` are the banks whose
    activations the controller has reported without making them active. `displaced` are the names of the balls
    and posts that a fault has displaced by more than the clearance that the paths keep. `shared` and `proxy` are the
    world with its lock and the proxy of a night on a real wire, and `connect` makes the devices of a rig. `axes_linked`
    is True if the axes are behind the proxy, so that they must stand still once it lets nothing pass.
    """

    world: World
    journal: Callable[[], JournalReader]
    memory: InMemoryDatabase | None = None
    clock: WatchedClock = field(default_factory=WatchedClock)
    device: FaultyDevice | None = None
    shared: SharedWorld[World] | None = None
    proxy: LinkProxy | None = None
    connect: Callable[[SimulatedMachineDevice, Clock], RigDevices] = _one_device
    axes_linked: bool = False
    supervisor: Supervisor | None = None
    connections: list[sqlite3.Connection] = field(default_factory=list)
    size: str = ""
    stopped_s: float | None = None
    aborted_s: float | None = None
    journal_writable: bool = True
    repairs: list[Callable[[], object]] = field(default_factory=list)
    deceived: set[int] = field(default_factory=set)
    displaced: set[str] = field(default_factory=set)

    @property
    def machine(self) -> FaultyDevice:
        """Device of the rig; the rig must have been made."""
        assert self.device is not None
        return self.device

    def note_stop(self) -> None:
        """Note that the axes must stand still from now on."""
        self.stopped_s = self.clock.now() if self.stopped_s is None else self.stopped_s

    def note_abort(self) -> None:
        """Note that an abort or an end of the program is requested now."""
        self.aborted_s = self.clock.now() if self.aborted_s is None else self.aborted_s

    def tell_connections(self, statement: str) -> None:
        """Execute a statement on every open connection of the run to its database."""
        for connection in self.connections:
            with contextlib.suppress(sqlite3.ProgrammingError):  # it was closed
                connection.execute(statement)

    def repair(self) -> None:
        """Remove every fault of the computer, the cell and a real link, the last one first."""
        for repair in reversed(self.repairs):
            repair()
        self.repairs.clear()
        self.journal_writable = True
        if self.proxy is not None:
            self.proxy.repair()

    def start_again(self) -> None:
        """Prepare for another run, at the present instant of the world; what disturbed the one before is over."""
        self.clock = WatchedClock(self.world.now)
        self.stopped_s = self.aborted_s = None
        self.deceived.clear()

    def rig(self, clock: Clock, settings: Settings) -> Rig:
        """Return a rig of which one faulty device plays every role, except for those that devices on a real link
        play."""
        # A device sleeps on the interruptible clock of the run, but the world follows the clock below it.
        self.clock.subscribe(self.world.advance_to if self.shared is None else self.shared.advance_to)
        found = self.connect(SimulatedMachineDevice(self.world, clock), clock)
        self.device = FaultyDevice(found.cnc, self.world, self.clock)
        cnc: Any = self.device
        other = cnc if found.other is None else found.other
        mount = other if found.mount is None else found.mount
        devices = {found.name: cnc, **({} if other is cnc else {DEVICE: other})}
        if mount is not other:
            devices[found.mount_name] = mount
        mounts = dict.fromkeys(range(1, len(settings.stations.places_mm) + 1), mount)
        return Rig(devices, cnc, cnc, mounts, cnc, cnc, other, clock)


def build_world(seed: int, banks: Sequence[int] = (1, 2, OTHER_BANK)) -> World:
    """Return a world with a machine, an artefact and noise drawn with `seed`.

    A table from an earlier run is active. If there is a third bank, it holds a table that is not volcal's.
    """
    shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
    settings = shipped.settings
    drawn = settings.model_copy(
        update={
            "seed": seed,
            "truth": settings.truth.model_copy(update={"seed": seed, "scale": SCALE}),
            "artefact_truth": settings.artefact_truth.model_copy(update={"seed": seed}),
            "store": settings.store.model_copy(update={"banks": list(banks)}),
        }
    )
    world = World(dataclasses.replace(shipped, settings=drawn))
    if OTHER_BANK in banks:
        world.controller.write_bank(OTHER_BANK, OTHER_TABLE)
    world.controller.write_bank(FORMER_BANK, FORMER_TABLE)
    world.controller.activate(FORMER_BANK)
    return world
