"""Driver plugin ``canopen-mount`` for a rotary mount with two CiA 402 drives on a CAN bus."""

from __future__ import annotations

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.links.can_adapters import CanAddress
from drivers.registry import DeviceContext, DriverPlugin


def create(settings: CanopenMountSettings, context: DeviceContext) -> CanopenMount:
    return CanopenMount(settings, context)


def claims(settings: CanopenMountSettings) -> dict[str, str]:
    """Return the resources that the mount claims: its node ids on the CAN bus; each can have only one owner."""
    bus = CanAddress.of(settings.interface, settings.channel, settings.options).name
    return {
        f"CANopen node {axis.node_id} on {bus}": f"{name}.node_id"
        for name, axis in (("azimuth", settings.azimuth), ("elevation", settings.elevation))
    }


PLUGIN = DriverPlugin("canopen-mount", CanopenMountSettings, create, claims)
