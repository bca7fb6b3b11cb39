"""Identity check of a drive: device profile, manufacturer, product, serial number and supported modes."""

from __future__ import annotations

from drivers.canopen_mount import objects
from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.settings import AxisSettings
from drivers.errors import ProtocolError


def verify_identity(node: DriveNode, settings: AxisSettings) -> None:
    """Raise ProtocolError if the node is not the drive described by the settings."""
    kind = node.read(objects.DEVICE_TYPE) & 0xFFFF
    if kind != objects.CIA_402:
        raise ProtocolError(
            f"the node is not a CiA 402 drive: its device profile is {kind}",
            hint="check the node id: another device answers there",
            **node.where,
        )
    for entry, expected in (
        (objects.VENDOR_ID, settings.vendor_id),
        (objects.PRODUCT_CODE, settings.product_code),
        (objects.SERIAL_NUMBER, settings.serial_number),
    ):
        if expected is not None and (found := node.read(entry)) != expected:
            raise ProtocolError(
                f"{entry} is 0x{found:X}, expected 0x{expected:X}",
                hint="check the node id, and that azimuth and elevation are not swapped",
                **node.where,
            )
    _require_modes(node, settings)


def _require_modes(node: DriveNode, settings: AxisSettings) -> None:
    supported = node.read(objects.SUPPORTED_MODES)
    needed = {objects.PROFILE_POSITION: "profile position"}
    if settings.homing is not None:
        needed[objects.HOMING] = "homing"
    for mode, name in needed.items():
        if not supported & objects.mode_bit(mode):
            raise ProtocolError(f"the drive does not support the {name} mode (0x6502)", **node.where)
