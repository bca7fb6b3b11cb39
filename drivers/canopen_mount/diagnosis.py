"""What a look at a drive tells without moving or writing anything."""

from __future__ import annotations

from statistics import median

from drivers.canopen_mount import objects
from drivers.canopen_mount.drive import Drive
from drivers.canopen_mount.states import DriveState
from drivers.clock import wall_seconds
from drivers.errors import DeviceError
from drivers.roles import Finding

LATENCY_READS = 10


def examine(drive: Drive) -> list[Finding]:
    """Reach and latency, identity, state, position, heartbeat; ends at the first thing that fails."""
    subject = f"{drive.node.axis} drive (node {drive.node.node_id})"
    findings: list[Finding] = []
    for look in (_latency, _identity, _state, _position, _heartbeat):
        try:
            ok, text = look(drive)
        except DeviceError as error:
            findings.append(Finding(subject, ok=False, text=str(error)))
            break
        findings.append(Finding(subject, ok=ok, text=text))
    return findings


def _latency(drive: Drive) -> tuple[bool, str]:
    times_ms: list[float] = []
    for _ in range(LATENCY_READS):
        start_s = wall_seconds()
        drive.node.read(objects.STATUSWORD)
        times_ms.append(1e3 * (wall_seconds() - start_s))
    return True, f"answers; SDO round trip median {median(times_ms):.2f} ms, longest {max(times_ms):.2f} ms"


def _identity(drive: Drive) -> tuple[bool, str]:
    drive.prove_identity()
    vendor, product = drive.node.read(objects.VENDOR_ID), drive.node.read(objects.PRODUCT_CODE)
    return True, f"CiA 402 drive, vendor 0x{vendor:08X}, product 0x{product:08X}"


def _state(drive: Drive) -> tuple[bool, str]:
    state = drive.state()
    if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
        return False, f"{state.value}: {drive.fault_text()}"
    return True, state.value


def _position(drive: Drive) -> tuple[bool, str]:
    angle = drive.angle_deg()
    lower, upper = drive.settings.lower_deg, drive.settings.upper_deg
    return lower <= angle <= upper, f"at {angle:.4f} degrees, limits {lower:g} ... {upper:g}"


def _heartbeat(drive: Drive) -> tuple[bool, str]:
    period_ms = drive.node.read(objects.HEARTBEAT_TIME)
    return (
        True,
        f"heartbeat every {period_ms} ms" if period_ms else "heartbeat off (it is set when the mount opens)",
    )
