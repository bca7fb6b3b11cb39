"""Diagnosis of a drive by reading only; no object is written and the drive does not move."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from statistics import median

from drivers.canopen_mount import objects, states
from drivers.canopen_mount.drive import Drive
from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.factors import expected_factors, factor_text
from drivers.canopen_mount.identity import verify_identity
from drivers.canopen_mount.limits import active_switches, read_soft_limits
from drivers.canopen_mount.states import DriveState
from drivers.clock import wall_seconds
from drivers.errors import DeviceError
from drivers.roles import DiagnosticFinding

LATENCY_READS = 20

Line = tuple[bool, str]


def diagnose_drive(drive: Drive) -> list[DiagnosticFinding]:
    """Diagnose a drive by reading only, and return the findings.

    The findings concern latency, identity, versions, state, supply, position, units, limits and monitoring.

    If the drive does not answer or refuses a query, the list ends with the error of this query.
    """
    subject = f"{drive.node.axis} drive (node {drive.node.node_id})"
    findings: list[DiagnosticFinding] = []
    try:
        for look in _CHECKS:
            findings.extend(DiagnosticFinding(subject, ok=ok, text=text) for ok, text in look(drive))
    except DeviceError as error:
        findings.append(DiagnosticFinding(subject, ok=False, text=str(error)))
    return findings


def _latency(drive: Drive) -> Iterator[Line]:
    times_ms: list[float] = []
    for _ in range(LATENCY_READS):
        start_s = wall_seconds()
        drive.node.read(objects.STATUSWORD)
        times_ms.append(1e3 * (wall_seconds() - start_s))
    yield True, f"answers; SDO round trip median {median(times_ms):.2f} ms, longest {max(times_ms):.2f} ms"


def _identity(drive: Drive) -> Iterator[Line]:
    node = drive.node
    verify_identity(node, drive.settings)
    vendor, product = node.read(objects.VENDOR_ID), node.read(objects.PRODUCT_CODE)
    revision, serial = node.read_optional(objects.REVISION), node.read_optional(objects.SERIAL_NUMBER)
    yield (
        True,
        (
            f"CiA 402 drive, vendor 0x{vendor:08X}, product 0x{product:08X}"
            f"{_hexadecimal(', revision', revision)}{_hexadecimal(', serial number', serial)}"
        ),
    )
    if not drive.identity_stated:
        yield True, "any drive is accepted: set vendor_id and product_code, or an EDS file, to detect a wrong one"
    texts = [node.read_text(index) for index in (objects.DEVICE_NAME, objects.HARDWARE_VERSION)]
    software = node.read_text(objects.SOFTWARE_VERSION)
    yield True, f"{texts[0] or 'no name'}, hardware {texts[1] or 'not reported'}, software {software or 'not reported'}"


def _state(drive: Drive) -> Iterator[Line]:
    status = drive.node.read(objects.STATUSWORD)
    state = drive.state_of(status)
    name = f"statusword 0x{status:04X}, {state.value}"
    if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
        yield False, f"{name}: {drive.fault_text()}"
    else:
        yield True, name
    if status & states.WARNING:
        yield False, f"the drive warns (statusword bit 7): {drive.fault_text()}"
    last = drive.node.read_optional(objects.LAST_ERROR)
    if last:
        yield True, f"last error in its memory (0x1003): {emergency_text(last & 0xFFFF)}"


def _supply(drive: Drive) -> Iterator[Line]:
    voltage_mv = drive.node.read_optional(objects.DC_LINK_MV)
    text = (
        "the drive does not report its DC link voltage" if voltage_mv is None else f"DC link {voltage_mv / 1e3:.1f} V"
    )
    yield voltage_mv is None or voltage_mv > 0, text


def _position(drive: Drive) -> Iterator[Line]:
    angle = drive.angle_deg()
    lower, upper = drive.settings.lower_deg, drive.settings.upper_deg
    yield lower <= angle <= upper, f"at {angle:.4f} degrees, limits {lower:g} ... {upper:g}"


def _units(drive: Drive) -> Iterator[Line]:
    for factor in expected_factors(drive.settings):
        yield factor_text(drive.node, factor)


def _limits(drive: Drive) -> Iterator[Line]:
    for name in active_switches(drive.node).values():
        yield False, f"the {name} is active (0x60FD)"
    limits = read_soft_limits(drive.node)
    if limits is None:
        yield True, "no software limits in the drive (0x607D)"
        return
    scale, settings = drive.settings.scale, drive.settings
    held = all(limits.contains(scale.counts(angle)) for angle in (settings.lower_deg, settings.upper_deg))
    lower, upper = sorted((scale.angle_deg(limits.lower), scale.angle_deg(limits.upper)))
    narrow = "" if held else ": narrower than lower_deg ... upper_deg, positions beyond them are refused"
    yield held, f"software limits of the drive {lower:g} ... {upper:g} degrees (0x607D){narrow}"


def _monitoring(drive: Drive) -> Iterator[Line]:
    period_ms = drive.node.read(objects.HEARTBEAT_TIME)
    yield True, f"heartbeat every {period_ms} ms" if period_ms else "heartbeat off (it is set when the mount opens)"
    watched = drive.node.read_optional(objects.WATCHED_HEARTBEAT) or 0
    if watched & 0xFFFF:
        source = f"of node {watched >> 16 & 0x7F} every {watched & 0xFFFF} ms (0x1016:01)"
        yield False, f"the drive expects a heartbeat {source}, which volcal does not send: it would fault"


def _hexadecimal(name: str, value: int | None) -> str:
    return "" if value is None else f"{name} 0x{value:X}"


_CHECKS: tuple[Callable[[Drive], Iterator[Line]], ...] = (
    _latency,
    _identity,
    _state,
    _supply,
    _position,
    _units,
    _limits,
    _monitoring,
)
