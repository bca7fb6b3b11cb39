"""Rig with a mount driver and simulated drives, connected by a virtual bus and driven by a virtual clock."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import can

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import VirtualClock
from drivers.links.can_bus import CanNetworks
from drivers.registry import DeviceContext
from simulators.wire.can.drive import DriveConfig, ServoDrive, drive_node
from simulators.wire.can.node import CanopenNode
from simulators.wire.can.parameters import FactorGroup
from simulators.wire.can.server import CanServer

COUNTS_PER_DEGREE = 10_000 * 36 / 360
"""Scale: 10000 counts per motor turn and 36 motor turns per turn of the mount give 1000 counts per degree."""

CYCLE_S = 0.02
"""Cycle of the receiving threads in s, short so that a rig closes quickly."""

_channels = itertools.count()


@dataclass
class LinearAxes:
    """Axes that turn at constant speed. `lag_s` is added to every turn."""

    now: float = 0.0
    lag_s: float = 0.2
    at: dict[str, float] = field(default_factory=lambda: {"azimuth": 0.0, "elevation": 0.0})
    turns: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    commands: list[tuple[str, float, float | None]] = field(default_factory=list)
    offset_deg: float = 0.0

    def begin_turn(self, axis: str, angle_deg: float, speed_deg_per_s: float | None) -> None:
        self.commands.append((axis, angle_deg, speed_deg_per_s))
        start = self.position_deg(axis)
        duration = abs(angle_deg - start) / (speed_deg_per_s or 10.0) + self.lag_s
        self.turns[axis] = (self.now, self.now + duration, start, angle_deg + self.offset_deg)

    def position_deg(self, axis: str) -> float:
        if axis not in self.turns:
            return self.at[axis]
        begins, ends, start, target = self.turns[axis]
        share = min(1.0, (self.now - begins) / (ends - begins))
        return start + share * (target - start)

    def moving(self, axis: str) -> bool:
        return axis in self.turns and self.now < self.turns[axis][1]

    def halt(self, axis: str | None = None) -> None:
        for name in list(self.turns):
            if axis in (None, name):
                self.at[name] = self.position_deg(name)
                del self.turns[name]

    def advance(self, now_s: float) -> None:
        self.now = now_s


@dataclass
class Rig:
    mount: CanopenMount
    clock: VirtualClock
    axes: LinearAxes
    azimuth: ServoDrive
    elevation: ServoDrive
    azimuth_node: CanopenNode
    elevation_node: CanopenNode
    server: CanServer
    networks: CanNetworks
    settings: CanopenMountSettings
    sniffer: can.BusABC

    def frames(self) -> list[tuple[int, bytes]]:
        """Return the frames on the bus since the last call."""
        seen = []
        while (message := self.sniffer.recv(0.0)) is not None:
            seen.append((message.arbitration_id, bytes(message.data)))
        return seen

    def writes(self, node_id: int, index: int) -> list[bytes]:
        """Return the data of expedited downloads to an object since the last call."""
        return [
            data[4:]
            for identifier, data in self.frames()
            if identifier == 0x600 + node_id and data[0] >> 5 == 1 and data[1] | data[2] << 8 == index
        ]


def axis_settings(own_node_id: int, **changes: Any) -> dict[str, Any]:
    return {
        "node_id": own_node_id,
        "encoder_counts_per_revolution": 10_000,
        "gear_motor_revolutions": 36,
        "lower_deg": -180.0,
        "upper_deg": 180.0,
        "speed_deg_per_s": 10.0,
        "acceleration_deg_per_s2": 50.0,
        **changes,
    }


@contextmanager
def rig(
    *,
    opened: bool = True,
    azimuth: dict[str, Any] | None = None,
    elevation: dict[str, Any] | None = None,
    **settings: Any,
) -> Iterator[Rig]:
    channel = f"rig-{next(_channels)}"
    axes, clock, networks = LinearAxes(), VirtualClock(), CanNetworks()
    factors = FactorGroup.in_increments(10_000, 36)
    azimuth_node, azimuth_drive = drive_node(DriveConfig(5, "azimuth", COUNTS_PER_DEGREE, factors=factors), axes)
    elevation_node, elevation_drive = drive_node(DriveConfig(6, "elevation", COUNTS_PER_DEGREE), axes)
    sniffer = can.Bus(interface="virtual", channel=channel)
    server = CanServer(can.Bus(interface="virtual", channel=channel), [azimuth_node, elevation_node], threading.RLock())
    clock.subscribe(axes.advance)
    clock.subscribe(server.advance)
    stated = CanopenMountSettings.model_validate(
        {
            "interface": "virtual",
            "channel": channel,
            "azimuth": axis_settings(5, **(azimuth or {})),
            "elevation": axis_settings(6, **(elevation or {})),
            "sdo_timeout_s": 2.0,
            **settings,
        }
    )
    mount = CanopenMount(stated, DeviceContext("mount", clock, Path()), networks)
    with (
        patch("drivers.links.can_bus.RECEIVE_CYCLE_S", CYCLE_S),
        patch("simulators.wire.can.server.RECEIVE_CYCLE_S", CYCLE_S),
        server,
        sniffer,
    ):
        try:
            if opened:
                mount.open()
            yield Rig(
                mount,
                clock,
                axes,
                azimuth_drive,
                elevation_drive,
                azimuth_node,
                elevation_node,
                server,
                networks,
                stated,
                sniffer,
            )
        finally:
            mount.close()
