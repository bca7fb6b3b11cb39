"""Virtual time, and a PLC in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest
from modbus_plc import FakePlc

from drivers.clock import VirtualClock


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock()


@pytest.fixture
def plc(clock: VirtualClock) -> Iterator[FakePlc]:
    with closing(FakePlc()) as server:
        clock.subscribe(server.advance_to)
        yield server
