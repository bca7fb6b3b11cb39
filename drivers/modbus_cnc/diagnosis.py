"""Self-diagnosis of a `modbus-cnc` device for `volcal doctor`. It only reads from the controller.

On a serial line, it also covers the timing, faults on the line, and the baud rate of a silent controller.
"""

from __future__ import annotations

from collections.abc import Iterator

from drivers.clock import Clock
from drivers.errors import DeviceError, LinkTimeout
from drivers.links.modbus_rtu import RtuTransport
from drivers.links.modbus_serial_line import SerialLine
from drivers.links.modbus_transport import DamagedFrame
from drivers.modbus_cnc.codes import PROBE_HEALTHY, PROBE_LOADED, fault_text
from drivers.modbus_cnc.link_factory import create_link
from drivers.modbus_cnc.registers import StatusImage
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import DiagnosticFinding

LATENCY_READS = 50
SLOW_ROUND_TRIP_S = 0.1
"""Largest acceptable median round trip in s, a quarter of the poll interval.

A slower link leaves too little time for the heartbeat. On a serial line the transmission time is added.
"""
HEARTBEAT_PAUSE_S = 0.3
"""Pause in s between two readings of the heartbeat; the register map requires a new heartbeat every 0.25 s."""
USUAL_BAUDS = (9600, 19200, 38400, 57600, 115200)
USUAL_PARITIES = ("even", "none", "odd")
WATCHDOG_S = 1.0
"""Time in s without a new heartbeat after which the controller stops the motion (register map, section 7)."""


def diagnose(session: ModbusSession) -> list[DiagnosticFinding]:
    """Return the findings about the controller of `session` in troubleshooting order.

    A device error ends the checks and is added as a finding. If this function opened the link to the controller and the
    error suggests wrong settings of a serial line, a finding about the baud rate follows.
    """
    findings: list[DiagnosticFinding] = []
    opened_here = not session.link.connected
    try:
        with session.reconnection.suspended():
            if opened_here:
                session.link.open()
            findings.extend(_findings(session))
    except DeviceError as error:
        findings.append(DiagnosticFinding("link", ok=False, text=str(error)))
        if opened_here:
            session.close()
            findings.extend(search_baud_rate(session.settings, session.clock, session.where["device"], error))
    finally:
        if opened_here:
            session.close()
    return findings


def _findings(session: ModbusSession) -> Iterator[DiagnosticFinding]:
    status = session.read_status_unchecked()
    version = f"{status.version >> 8}.{status.version & 0xFF}"
    yield DiagnosticFinding("link", ok=True, text=f"{session.where['link']}, register map version {version}")
    yield _heartbeat(session, status)
    yield _latency(session)
    if session.settings.serial is not None:
        yield from line_findings(session, session.settings.serial)
    yield from _machine(status)
    limits = session.read_limits()
    travel = ", ".join(
        f"{axis} {low:g} … {high:g} mm" for axis, low, high in zip("XYZ", limits.lower, limits.upper, strict=True)
    )
    yield DiagnosticFinding("travel", ok=True, text=travel)
    yield DiagnosticFinding(
        "tables",
        ok=limits.banks > 0,
        text=f"{limits.banks} banks, active {status.active_bank}, resolution {limits.resolution * 1e3:g} µm",
    )


def _heartbeat(session: ModbusSession, before: StatusImage) -> DiagnosticFinding:
    session.clock.sleep(HEARTBEAT_PAUSE_S)
    after = session.read_status_unchecked()
    runs = after.heartbeat != before.heartbeat
    return DiagnosticFinding("heartbeat", ok=runs, text="runs" if runs else f"stuck at {after.heartbeat}")


def _latency(session: ModbusSession) -> DiagnosticFinding:
    for _ in range(LATENCY_READS):
        session.read_status_unchecked()
    latency = session.link.latency
    text = f"median {latency.median_s * 1e3:.2f} ms, worst {latency.worst_s * 1e3:.2f} ms"
    return DiagnosticFinding("latency", ok=latency.median_s <= SLOW_ROUND_TRIP_S + session.poll_wire_time_s, text=text)


def _machine(status: StatusImage) -> Iterator[DiagnosticFinding]:
    fault = fault_text(status.fault_code)
    yield DiagnosticFinding("state", ok=not fault, text=status.state.value + (f": {fault}" if fault else ""))
    missing = [name.value for name, given in status.permissions.items() if not given]
    yield DiagnosticFinding(
        "permissions", ok=not missing, text=f"missing: {', '.join(missing)}" if missing else "all given"
    )
    loaded, healthy = bool(status.probe_bits & PROBE_LOADED), bool(status.probe_bits & PROBE_HEALTHY)
    text = f"{'loaded' if loaded else 'not loaded'}, {'healthy' if healthy else 'not healthy'}"
    yield DiagnosticFinding("probe", ok=loaded and healthy, text=text)
    yield DiagnosticFinding("temperatures", ok=status.temperature_count > 0, text=f"{status.temperature_count} sensors")


def line_findings(session: ModbusSession, line: SerialLine) -> Iterator[DiagnosticFinding]:
    """Yield findings about the duration of a poll (one exchange that writes the heartbeat and reads the status) and
    about the number of requests that had to be repeated.

    Call this function after the link of `session` has been used, because the function reads the counters of this link.
    """
    poll_s = session.poll_wire_time_s
    left_s = WATCHDOG_S - max(session.settings.poll_interval_s, poll_s) - poll_s - session.settings.timeout_s
    text = (
        f"a poll takes {poll_s * 1e3:.0f} ms of the line at {line.mode}; after one lost answer {left_s:.2f} s are left"
    )
    advice = "" if left_s > 0.0 else " of the controller's watchdog time: raise the baud rate or reduce timeout_s"
    yield DiagnosticFinding("line", ok=left_s > 0.0, text=text + advice)
    transport = session.link.transport
    if isinstance(transport, RtuTransport):
        repeated, stray = session.link.repeat_count, transport.stray_bytes
        text = f"{repeated} requests repeated, {stray} stray bytes, in {session.link.latency.count} requests"
        yield DiagnosticFinding("line faults", ok=repeated == stray == 0, text=text)


def search_baud_rate(
    settings: ModbusCncSettings, clock: Clock, device: str, error: DeviceError
) -> Iterator[DiagnosticFinding]:
    """Yield a finding about the baud rate and parity at which a silent controller answers.

    One register is read with each usual combination of baud rate and parity. The search is made only if the link is a
    serial line and `error`, the error that ended the diagnosis, is a time-out or a damaged frame.
    """
    if settings.serial is None or not isinstance(error, LinkTimeout | DamagedFrame):
        return
    for line in _other_lines(settings.serial):
        if _answers(settings.model_copy(update={"serial": line, "retries": 0}), clock, device):
            text = (
                f"the controller answers at {line.mode}: set serial.baud = {line.baud}, serial.parity = {line.parity!r}"
            )
            yield DiagnosticFinding("baud rate", ok=False, text=text)
            return
    tried = ", ".join(str(baud) for baud in USUAL_BAUDS)
    yield DiagnosticFinding("baud rate", ok=False, text=f"no answer at {tried} baud with even, no or odd parity either")


def _other_lines(line: SerialLine) -> Iterator[SerialLine]:
    for baud in USUAL_BAUDS:
        for parity in USUAL_PARITIES:
            if (baud, parity) != (line.baud, line.parity):
                yield line.model_copy(update={"baud": baud, "parity": parity})


def _answers(settings: ModbusCncSettings, clock: Clock, device: str) -> bool:
    link = create_link(settings, clock, device)
    try:
        link.open()
        link.read(settings.blocks.status, 1)
    except DeviceError:
        return False
    finally:
        link.close()
    return True
