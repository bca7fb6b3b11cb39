"""Entry point `modbus-cnc`."""

from __future__ import annotations

from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.registry import DeviceContext, DriverPlugin


def create(settings: ModbusCncSettings, context: DeviceContext) -> ModbusCnc:
    return ModbusCnc(settings, context.clock, context.name)


PLUGIN = DriverPlugin("modbus-cnc", ModbusCncSettings, create)
