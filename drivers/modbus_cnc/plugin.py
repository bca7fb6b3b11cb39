"""Driver plugin `modbus-cnc`."""

from __future__ import annotations

from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.registry import DeviceContext, DriverPlugin


def create(settings: ModbusCncSettings, context: DeviceContext) -> ModbusCnc:
    return ModbusCnc(settings, context.clock, context.name)


def claims(settings: ModbusCncSettings) -> dict[str, str]:
    """Return the serial port as a resource that no other device may use, because a serial line has only one master.

    The result is empty for a TCP link.
    """
    return {f"serial port {settings.serial.port}": "serial.port"} if settings.serial is not None else {}


PLUGIN = DriverPlugin("modbus-cnc", ModbusCncSettings, create, claims)
