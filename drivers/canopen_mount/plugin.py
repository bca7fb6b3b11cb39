"""The entry point ``canopen-mount``."""

from __future__ import annotations

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.registry import DeviceContext, DriverPlugin


def create(settings: CanopenMountSettings, context: DeviceContext) -> CanopenMount:
    return CanopenMount(settings, context)


PLUGIN = DriverPlugin("canopen-mount", CanopenMountSettings, create)
