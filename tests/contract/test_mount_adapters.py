"""Contract tests of the mount over each kind of CAN adapter: its behaviour must not depend on the adapter."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from aloud import NOT_HERE
from rigs import SimulatedRig, on_wires
from test_roles import TestRotaryMount

from simulators.wire.can.channel import multicast_works

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "system"))

from namespaces import kernel_can_missing

__all__ = ["TestRotaryMount"]

NEEDS_NOTHING = ("slcan:any", "socketcand:127.0.0.1:0")
MULTICAST = "udp_multicast:239.74.163.2:0"
KERNEL = "socketcan:vcan0"


def require(channel: str) -> None:
    if channel == MULTICAST and not multicast_works():
        pytest.skip(f"{NOT_HERE}: the mount's contract over multicast: this network has none")
    if channel == KERNEL and (absent := kernel_can_missing() or _no_interface()):
        pytest.skip(f"{NOT_HERE}: the mount's contract through the kernel (socketcan, vcan0): {absent}")


def _no_interface() -> str:
    return "" if Path("/sys/class/net/vcan0").exists() else "there is no interface vcan0"


@pytest.fixture(params=[*NEEDS_NOTHING, MULTICAST, KERNEL], ids=lambda channel: channel.partition(":")[0])
def rig(request: pytest.FixtureRequest) -> Iterator[SimulatedRig]:
    require(request.param)
    with on_wires(can=request.param) as machine:
        yield machine
