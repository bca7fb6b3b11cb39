"""The Modbus driver connected to the small PLC of `modbus_plc`, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from modbus_plc import FakePlc

from drivers.clock import Clock
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings


@contextmanager
def opened(plc: FakePlc, clock: Clock, **options: object) -> Iterator[ModbusCnc]:
    """Open the driver with these settings, by default with one repetition after 0.5 s, and close it at the end."""
    settings = ModbusCncSettings.model_validate(
        {"host": "127.0.0.1", "port": plc.port, "timeout_s": 0.5, "retries": 1, **options}
    )
    device = ModbusCnc(settings, clock, "cnc")
    device.open()
    with closing(device):
        yield device
