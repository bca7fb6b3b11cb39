"""Virtual time, a PLC in it, and the Modbus driver connected to this PLC."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest
from modbus_plc import FakePlc
from modbus_rig import opened

from drivers.clock import VirtualClock
from drivers.modbus_cnc.device import ModbusCnc


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def plc(clock: VirtualClock) -> Iterator[FakePlc]:
    with closing(FakePlc()) as server:
        clock.subscribe(server.advance_to)
        yield server


@pytest.fixture
def cnc(plc: FakePlc, clock: VirtualClock) -> Iterator[ModbusCnc]:
    with opened(plc, clock) as device:
        yield device
