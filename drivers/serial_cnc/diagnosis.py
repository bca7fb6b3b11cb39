"""Self-diagnosis of a GRBL controller for `volcal doctor`. It only reads and moves nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

from drivers.clock import wall_seconds
from drivers.errors import DeviceError
from drivers.roles import DiagnosticFinding
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.identity import read_identity
from drivers.serial_cnc.settings import SerialCncSettings
from drivers.serial_cnc.status_tracker import StatusTracker
from drivers.serial_cnc.store import BankStore

LATENCY_READS = 20
SLOW_ROUND_TRIP_S = 0.1
"""Largest acceptable median round trip in s: a quarter of the poll interval."""


def diagnose(
    conversation: Conversation, settings: SerialCncSettings, store: BankStore, directory: Path
) -> list[DiagnosticFinding]:
    """Return the findings about a GRBL controller in troubleshooting order.

    A device error ends the checks of the controller and is added as a finding. The last finding is always about the
    compensation tables.
    """
    findings: list[DiagnosticFinding] = []
    opened_here = not conversation.line.connected
    try:
        if opened_here:
            restarts = conversation.restarts
            conversation.open()
            findings.append(_opening(settings, restarted=conversation.restarts != restarts))
        findings.extend(_findings(conversation, settings))
    except DeviceError as error:
        findings.append(DiagnosticFinding("link", ok=False, text=str(error)))
    finally:
        if opened_here:
            conversation.close()
    findings.append(_tables(store, directory, status=opened_here))
    return findings


def _findings(conversation: Conversation, settings: SerialCncSettings) -> Iterator[DiagnosticFinding]:
    identity = read_identity(conversation)
    controller = identity.settings
    yield DiagnosticFinding("link", ok=True, text=f"{conversation.where['link']}, version {controller.version}")
    yield from controller.findings(manual_referencing=settings.manual_referencing)
    if controller.fatal():
        yield _latency(conversation.report)
        return
    limits = controller.limits(settings.axis_zero_mm)
    travel = ", ".join(
        f"{axis} {low:g} … {high:g} mm" for axis, low, high in zip("XYZ", limits.lower_mm, limits.upper_mm, strict=True)
    )
    yield DiagnosticFinding("travel", ok=True, text=travel)
    tracker = StatusTracker(conversation, controller, by_hand=settings.manual_referencing)
    tracker.set_work_offset(identity.parameters, identity.modes)
    yield _latency(tracker.read_status)  # enough reports to contain every occasional field
    status = tracker.read_status()
    yield DiagnosticFinding(
        "state", ok=not status.fault, text=status.word + (f": {status.fault}" if status.fault else "")
    )
    yield DiagnosticFinding(
        "permissions", ok=not status.missing, text=f"missing: {status.missing}" if status.missing else "all given"
    )
    text = (
        "deflected: touching something, or $6 is wrong" if status.deflected else "free; the controller reports no more"
    )
    yield DiagnosticFinding("probe", ok=not status.deflected, text=text)
    offset = ", ".join(f"{value:.3f}" for value in tracker.work_offset().tolist())
    yield DiagnosticFinding("work offset", ok=True, text=f"{offset} mm")
    feed, rapid = status.overrides
    yield DiagnosticFinding("overrides", ok=(feed, rapid) == (100, 100), text=f"feed {feed} %, rapids {rapid} %")
    stated = settings.declared_temperatures_c
    if stated:
        named = ", ".join(f"{name} {value:g} °C" for name, value in stated.items())
        yield DiagnosticFinding("temperatures", ok=True, text=f"stated, not measured: {named}")


def _opening(settings: SerialCncSettings, *, restarted: bool) -> DiagnosticFinding:
    """Report whether the board restarted when its port was opened, and whether it may be read between runs."""
    stated = not settings.restarts_when_opened
    if restarted:
        wrong = "; remove restarts_when_opened = false" if stated else ""
        text = f"the board restarted when its port was opened: it is not read between runs{wrong}"
        return DiagnosticFinding("opening", ok=not stated, text=text)
    text = "the board did not restart when its port was opened now; it may at the first time after it is plugged in"
    return DiagnosticFinding("opening", ok=True, text=text if not stated else "the board does not restart, as stated")


def _latency(status: Callable[[], object]) -> DiagnosticFinding:
    times_s: list[float] = []
    for _ in range(LATENCY_READS):
        start_s = wall_seconds()
        status()
        times_s.append(wall_seconds() - start_s)
    text = f"median {median(times_s) * 1e3:.2f} ms, worst {max(times_s) * 1e3:.2f} ms"
    return DiagnosticFinding("latency", ok=median(times_s) <= SLOW_ROUND_TRIP_S, text=text)


def _tables(store: BankStore, directory: Path, *, status: bool) -> DiagnosticFinding:
    """Report the tables in files; the text says that the controller itself has none."""
    try:
        if status and directory.exists():
            store.open()
    except DeviceError as error:
        return DiagnosticFinding("tables", ok=False, text=str(error))
    text = (
        f"none in the controller; files in {directory}, active {store.active_bank()}: the driver corrects what it "
        "commands, part programs are corrected only by `volcal gcode correct`"
    )
    return DiagnosticFinding("tables", ok=True, text=text)
