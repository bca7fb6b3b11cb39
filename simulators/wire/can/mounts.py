"""All mounts of the simulated machine on one CAN bus, with two drives each, and the faults that can be injected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Final

import can

from drivers.errors import InputError
from simulators.wire.can.channel import CanChannel, open_channel
from simulators.wire.can.drive import (
    FOLLOWING_ERROR,
    VENDOR_AND_PRODUCT,
    DriveConfig,
    MountAxes,
    ServoDrive,
    drive_node,
)
from simulators.wire.can.node import CanopenNode
from simulators.wire.can.parameters import FactorGroup
from simulators.wire.can.server import CanServer
from simulators.wire.can.slcan_peer import SlcanPeerBus

ENCODER_INCREMENTS: Final = 131072
GEAR: Final = 100
COUNTS_PER_DEGREE: Final = ENCODER_INCREMENTS * GEAR / 360
"""Encoder counts per degree: 17-bit encoder on the motor, gear ratio 100:1."""

AXES: Final = ("azimuth", "elevation")
OVER_CURRENT, DEVICE_TOO_HOT = 0x2310, 0x4210
BUS_OFF = can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=True, data=bytes(8))


class CanMounts:
    """Drives of all mounts on one CAN bus. The constructor opens the bus given by `spec`.

    `lock` protects the world, whose state the drives read.
    """

    def __init__(self, spec: str, mounts: Sequence[MountAxes], lock: AbstractContextManager[bool]) -> None:
        self._channel: CanChannel = open_channel(spec)
        pairs = zip(drive_configs(len(mounts)), mounts, strict=True)
        self._drives = {config.node_id: drive_node(config, mount) for configs, mount in pairs for config in configs}
        self._server = CanServer(self._channel.bus, [node for node, _ in self._drives.values()], lock)
        self.start = self._server.start
        self.close = self._server.close
        self.advance = self._server.advance

    @property
    def agent_settings(self) -> dict[str, object]:
        return self._channel.agent_settings

    def fail(self, node_id: int, fault: str) -> None:
        """Inject a fault into the drive with the given node id, or clear it. The caller must hold the lock of the
        world.

        Raises InputError for an unknown node or fault.
        """
        if node_id not in self._drives:
            raise InputError(f"there is no drive at node {node_id}", key="node", hint=f"nodes: {sorted(self._drives)}")
        node, drive = self._drives[node_id]
        faults = _faults(node, drive)
        faults["restart"] = partial(self._server.restart, node)
        faults["bus_off"] = self._go_off_bus
        if fault not in faults:
            raise InputError(f"unknown fault {fault!r} of a drive", key="fault", hint=f"one of {', '.join(faults)}")
        faults[fault]()

    def _go_off_bus(self) -> None:
        """Simulate bus-off, as after a short circuit.

        A serial adapter then forwards no frames; on other interfaces an error frame is sent.
        """
        if isinstance(self._channel.bus, SlcanPeerBus):
            self._channel.bus.go_off_bus()
        else:
            self._channel.bus.send(BUS_OFF)


def drive_configs(mounts: int) -> list[tuple[DriveConfig, ...]]:
    """Return the drive configurations of each mount.

    The drives of the first mount have the node ids 1 and 2, those of the second mount have 3 and 4, and so on.
    """
    return [
        tuple(_drive(2 * number + place, axis) for place, axis in enumerate(AXES, start=1)) for number in range(mounts)
    ]


def _drive(node_id: int, axis: str) -> DriveConfig:
    """Return the configuration of one drive; its serial number is its node id, so all serial numbers differ."""
    factors = FactorGroup.in_increments(ENCODER_INCREMENTS, GEAR)
    return DriveConfig(node_id, axis, COUNTS_PER_DEGREE, identity=(*VENDOR_AND_PRODUCT, 1, node_id), factors=factors)


def _faults(node: CanopenNode, drive: ServoDrive) -> dict[str, Callable[[], None]]:
    def silence() -> None:
        node.silent = True

    def mend() -> None:
        node.silent = False
        drive.jam(jammed=False)
        drive.lose_home_switch(lost=False)
        for direction in (1, -1):
            drive.press_limit_switch(direction, pressed=False)

    return {
        "following_error": partial(drive.trip, FOLLOWING_ERROR),
        "over_current": partial(drive.trip, OVER_CURRENT),
        "too_hot": partial(drive.warn, DEVICE_TOO_HOT),
        "jam": drive.jam,
        "positive_limit": partial(drive.press_limit_switch, 1),
        "negative_limit": partial(drive.press_limit_switch, -1),
        "no_home_switch": drive.lose_home_switch,
        "silence": silence,
        "no_heartbeat": node.stop_heartbeat,
        "mend": mend,
    }
