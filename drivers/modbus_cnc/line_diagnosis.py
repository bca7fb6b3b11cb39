"""Diagnosis of a serial line for `volcal doctor`: timing, line faults, and the baud rate of a silent controller."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.clock import Clock
from drivers.errors import DeviceError, LinkTimeout
from drivers.links.modbus_rtu import RtuTransport
from drivers.links.modbus_serial_line import SerialLine
from drivers.links.modbus_transport import DamagedFrame
from drivers.modbus_cnc.link_factory import create_link
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import DiagnosticFinding

USUAL_BAUDS = (9600, 19200, 38400, 57600, 115200)
USUAL_PARITIES = ("even", "none", "odd")
WATCHDOG_S = 1.0
"""Time in s without a new heartbeat after which the controller stops the motion (register map, section 7)."""


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
