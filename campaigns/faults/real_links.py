"""Real links of a night: Modbus TCP and Modbus RTU to the controller, CAN to the mount over a serial adapter or TCP.

The simulated device and the driver are those of the program, with a proxy between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from campaigns.faults.fault_scene import FaultScene, RigDevices
from campaigns.faults.link_proxy import LinkProxy, SerialProxy, TcpProxy, ending_with, modbus_frame, until_quiet
from campaigns.grbl.scene import OtherRoles
from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import Clock
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.registry import DeviceContext
from simulators.backend import SimulatedMachineDevice
from simulators.wire.can.mounts import AXES, ENCODER_INCREMENTS, GEAR, CanMounts
from simulators.wire.modbus.controller import ModbusController
from simulators.wire.modbus.rtu import LineSettings, ModbusRtuController
from simulators.wire.shared_world import SharedWorld

CNC = "cnc"
MOUNT = "mount-1"
SLCAN_BAUD = 115200
CAN_BUSES = ("slcan", "socketcand")
LONGEST_TURN_DEG = {"azimuth": 180.0, "elevation": 90.0}


class DeviceWithoutMount(SimulatedMachineDevice):
    """Simulated device whose stop does not reach the mount, which is on a link of its own."""

    def stop(self) -> None:
        self._catch_up()
        self._controller.halt()


@contextmanager
def linked(scene: FaultScene, link: str, directory: Path, can_bus: str) -> Iterator[None]:
    """Give the scene a real link of the kind `link`, with a proxy, during the `with` block; none if it is empty.

    `can_bus` is the kind of CAN bus. `directory` is for the name of a serial line.
    """
    if not link:
        yield
        return
    scene.shared = shared = SharedWorld(scene.world)
    with ExitStack() as open_links:
        if link == "TCP":
            scene.proxy = _modbus_tcp(scene, shared, open_links)
        elif link == "RTU":
            scene.proxy = _modbus_rtu(scene, shared, directory / "line", open_links)
        else:
            scene.proxy = _can(scene, shared, can_bus, directory / "adapter", open_links)
        yield


def _modbus_tcp(scene: FaultScene, shared: SharedWorld[Any], open_links: ExitStack) -> LinkProxy:
    controller = ModbusController(shared, ("127.0.0.1", 0))
    open_links.callback(controller.close)
    controller.start()
    proxy = TcpProxy(controller.address, modbus_frame)
    open_links.callback(proxy.close)
    _connect_modbus(scene, {"host": "127.0.0.1", "port": proxy.port})
    return proxy


def _modbus_rtu(scene: FaultScene, shared: SharedWorld[Any], line: Path, open_links: ExitStack) -> LinkProxy:
    settings = LineSettings()
    controller = ModbusRtuController(shared, settings)
    open_links.callback(controller.close)
    controller.start()
    options = controller.agent_settings["serial"]
    proxy = SerialProxy(options["port"], line, until_quiet, settings.baud)
    open_links.callback(proxy.close)
    _connect_modbus(scene, {"serial": {**options, "port": str(line)}})
    return proxy


def _connect_modbus(scene: FaultScene, options: dict[str, Any]) -> None:
    settings = ModbusCncSettings.model_validate(options)

    def devices(simulated: SimulatedMachineDevice, clock: Clock) -> RigDevices:
        return RigDevices(CNC, ModbusCnc(settings, clock, CNC), OtherRoles(simulated))

    scene.connect, scene.axes_linked = devices, True


def _can(scene: FaultScene, shared: SharedWorld[Any], bus: str, adapter: Path, open_links: ExitStack) -> LinkProxy:
    place = "any" if bus == "slcan" else "127.0.0.1:0"
    mounts = CanMounts(f"{bus}:{place}", tuple(scene.world.mounts.values()), shared.lock)
    open_links.callback(mounts.close)
    shared.subscribe(mounts.advance)
    mounts.start()
    options: dict[str, Any] = {**mounts.agent_settings}
    proxy: LinkProxy
    if bus == "slcan":
        proxy = SerialProxy(options["channel"], adapter, ending_with(b"\r"), SLCAN_BAUD)
        options["channel"] = str(adapter)
    else:
        address = options["options"]["host"], options["options"]["port"]
        proxy = TcpProxy(address, ending_with(b">"))
        options["options"] = {**options["options"], "port": proxy.port}
    open_links.callback(proxy.close)
    settings = CanopenMountSettings.model_validate({**options, **_axes()})

    def devices(_: SimulatedMachineDevice, clock: Clock) -> RigDevices:
        mount = CanopenMount(settings, DeviceContext(MOUNT, clock, Path()))
        return RigDevices(CNC, DeviceWithoutMount(scene.world, clock), mount=mount, mount_name=MOUNT)

    scene.connect = devices
    return proxy


def _axes() -> dict[str, dict[str, Any]]:
    drive = {
        "encoder_counts_per_revolution": ENCODER_INCREMENTS,
        "gear_motor_revolutions": GEAR,
        "speed_deg_per_s": 20.0,
        "acceleration_deg_per_s2": 40.0,
    }
    return {
        axis: {**drive, "node_id": node, "lower_deg": -LONGEST_TURN_DEG[axis], "upper_deg": LONGEST_TURN_DEG[axis]}
        for node, axis in enumerate(AXES, start=1)
    }
