"""Rigs with the same ideal machine: in this process, and behind Modbus TCP, CANopen and the control channel."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from drivers.clock import Clock, InterruptibleClock, LockstepClock, VirtualClock
from drivers.contract.rig import ContractRig, Interrupt
from drivers.registry import DeviceContext, create_device
from drivers.roles import CompensationStore, Machine, Operator, Probe, RotaryMount, Thermometer
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import read_scenario
from simulators.wire.modbus.rtu import LineSettings
from simulators.wire.wired_machine import Links, WiredMachine
from simulators.world.world import World

SCENARIO = Path(__file__).resolve().parents[2] / "config" / "simulators" / "case-study.toml"
TOOL = np.array([0.0, 250.0, 0.0])
REACH = 15.5
"""Sum of the radii of the ball and the tip."""
ANY = ("127.0.0.1", 0)
MORE_OPTIONS: dict[str, dict[str, Any]] = {"serial": {"declared_temperatures_c": {"artefact": 20.0}}}
channels = itertools.count()


@dataclass
class SimulatedRig(ContractRig):
    """Rig with every role of one machine. The tests only read `world`."""

    outside_mm = ((4000.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 1e9))
    clear_of_mount_mm = (2900.0, 0.0, 750.0)

    machine: Machine
    probe: Probe
    mount: RotaryMount
    store: CompensationStore
    thermometer: Thermometer
    operator: Operator
    clock: Clock
    interrupt: Interrupt
    world: World
    resolution_mm: float = 1e-5
    """Resolution of positions on the link, mm."""

    def ball(self, number: int) -> np.ndarray:
        """Return the axis positions, shape (3,), that would put the tip of this ideal machine at the ball's centre."""
        return np.array(self.world.workpiece.snapshot(self.world.now).balls[number]) - TOOL

    def before(self, number: int, distance_mm: float = 25.0) -> np.ndarray:
        """Move the tip in front of the ball, on its -Y side, and return the ball's axis position."""
        centre = self.ball(number)
        self.machine.move_to(np.array([centre[0], 0.0, centre[2]]), feed_mm_per_s=None, guarded=True)
        self.machine.move_to(centre - [0.0, distance_mm, 0.0], feed_mm_per_s=None, guarded=True)
        return centre

    def approach(self) -> np.ndarray:
        return self.before(5)

    def trip_mm(self, target_mm: np.ndarray) -> np.ndarray:
        return target_mm - [0.0, REACH, 0.0]


@contextmanager
def in_process() -> Iterator[SimulatedRig]:
    clock = VirtualClock()
    interrupt = Interrupt(clock)
    watched = InterruptibleClock(clock, interrupt.check)
    world = World(read_scenario(SCENARIO).without_errors())
    device = SimulatedMachineDevice(world, watched)
    device.open()
    yield SimulatedRig(device, device, device, device, device, device, watched, interrupt, world)
    device.close()


def over_rtu() -> AbstractContextManager[SimulatedRig]:
    """Return a rig with Modbus RTU on a pseudo-terminal, at the standard's 19200 baud, 8E1."""
    return on_wires(modbus_rtu=LineSettings())


def over_serial() -> AbstractContextManager[SimulatedRig]:
    """Return a rig with GRBL on a pseudo-terminal: steps of one micrometre, tables in files, a stated temperature."""
    return on_wires("serial", 1.1e-3, serial="any")


@contextmanager
def on_wires(cnc_link: str = "modbus", resolution_mm: float = 1e-5, **links: Any) -> Iterator[SimulatedRig]:
    links = {"can": f"virtual:contract-{next(channels)}", **links}
    machine = WiredMachine(read_scenario(SCENARIO).without_errors(), Links(ANY, ANY, **links))
    machine.start()
    assert machine.time is not None
    clock = LockstepClock(*machine.time.address)
    interrupt = Interrupt(clock)
    watched = InterruptibleClock(clock, interrupt.check)
    ready = machine.ready_line()
    devices = {
        "cnc": (f"{cnc_link}-cnc", {**ready[cnc_link], **MORE_OPTIONS.get(cnc_link, {})}),
        "mount": ("canopen-mount", {**ready["can"], **drives(ready["can_nodes"]), "sdo_timeout_s": 2.0}),
        "operator": ("simulated-operator", ready["control"]),
    }
    opened: dict[str, Any] = {}
    files = TemporaryDirectory()
    try:
        for name, (driver, options) in devices.items():
            opened[name] = create_device(driver, options, DeviceContext(name, watched, Path(files.name)))
            opened[name].open()
        cnc = opened["cnc"]
        roles = (cnc, cnc, opened["mount"], cnc, cnc, opened["operator"])
        yield SimulatedRig(*roles, watched, interrupt, machine.world, resolution_mm)
    finally:
        for device in reversed(opened.values()):
            device.close()
        clock.close()
        machine.close()
        files.cleanup()


def drives(nodes: dict[str, int]) -> dict[str, Any]:
    limits = {"azimuth": 180.0, "elevation": 90.0}
    return {
        axis: {
            "node_id": node,
            "encoder_counts_per_revolution": 131072,
            "gear_motor_revolutions": 100,
            "lower_deg": -limits[axis],
            "upper_deg": limits[axis],
            "speed_deg_per_s": 20.0,
            "acceleration_deg_per_s2": 40.0,
        }
        for axis, node in nodes.items()
    }
