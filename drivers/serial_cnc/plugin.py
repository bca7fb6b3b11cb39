"""Driver plugin `serial-cnc`."""

from __future__ import annotations

from drivers.registry import DeviceContext, DriverPlugin
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.settings import SerialCncSettings


def create(settings: SerialCncSettings, context: DeviceContext) -> SerialCnc:
    return SerialCnc(settings, context)


def claims(settings: SerialCncSettings) -> dict[str, str]:
    """Return the serial port as a resource that no other device may use."""
    return {f"serial port {settings.port}": "port"}


PLUGIN = DriverPlugin("serial-cnc", SerialCncSettings, create, claims)
