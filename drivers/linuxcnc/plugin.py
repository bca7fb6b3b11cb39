"""Driver plugin `linuxcnc` for machines controlled by LinuxCNC."""

from __future__ import annotations

from drivers.linuxcnc.device import LinuxCnc
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.registry import DeviceContext, DriverPlugin


def create(settings: LinuxCncSettings, context: DeviceContext) -> LinuxCnc:
    return LinuxCnc(settings, context)


PLUGIN = DriverPlugin("linuxcnc", LinuxCncSettings, create)
