"""Diagnosis of a LinuxCNC device for the command `volcal doctor`; it reads only."""

from __future__ import annotations

import re
from collections.abc import Iterator

from drivers.clock import wall_seconds
from drivers.errors import VolcalError
from drivers.linuxcnc.compensation import LinuxCncStore
from drivers.linuxcnc.session import XYZ, LinuxCncSession
from drivers.linuxcnc.snapshot import Snapshot
from drivers.roles import DiagnosticFinding

LATENCY_READS = 50
SLOW_ROUND_TRIP_S = 0.05
SKEW_LEAST_S = 1e-3
"""Tolerance in s of the skew between LinuxCNC's clock and ours, which run on the same computer.

The duration of the longest round trip is added to this tolerance.
"""
LONGEST_PERIOD_S = 1e-3
LEAST_MARGIN_ERROR_MM = 1e-6
LATCH_MM_PER_S = 5.0
"""Usual touch feed in mm/s (300 mm/min), at which the diagnosis states the travel during the latch delay."""
_NUMBERS = re.compile(r"(\d+)\.(\d+)(?:\.(\d+))?")
_SUPPORTED = (2, 9)
_PROBING_MENDED = 5
"""Third number of the first release 2.9 that permits the contact of the probe to bounce while the axes brake."""


def diagnose(session: LinuxCncSession, store: LinuxCncStore | None) -> list[DiagnosticFinding]:
    """Return the findings in the order in which a user should check them.

    An error ends the diagnosis and becomes the last finding.
    """
    findings: list[DiagnosticFinding] = []
    opened_here = not session.link.connected
    try:
        if opened_here:
            session.open()
        findings.extend(_findings(session))
        findings.extend(_tables(store))
    except VolcalError as error:
        findings.append(DiagnosticFinding("bridge", ok=False, text=str(error)))
    finally:
        if opened_here:
            session.link.close()
    return findings


def _findings(session: LinuxCncSession) -> Iterator[DiagnosticFinding]:
    hello = session.link.hello
    yield DiagnosticFinding(
        "bridge", ok=True, text=f"LinuxCNC {hello['version']}, {session.properties.machine_name}, {hello['ini']}"
    )
    yield _version(hello["version"])
    yield _heartbeats(hello["watched"])
    first = session.read_snapshot()
    yield _latency(session, first)
    yield _state(first)
    missing = [name.value for name, given in session.permissions(first).items() if not given]
    yield DiagnosticFinding(
        "permissions", ok=not missing, text=f"missing: {', '.join(missing)}" if missing else "all given"
    )
    yield _probe(session, first)
    yield _travel(session)
    yield from _joint_margin(session)
    yield from _overrides(first)
    yield from _ini(session)
    yield _temperatures(session)


def _version(version: str) -> DiagnosticFinding:
    """Return what is known of a version, as LinuxCNC itself writes it, for example ``2.9.4`` or ``2.10.0~pre0``."""
    numbers = _NUMBERS.match(version)
    if numbers is None:
        return DiagnosticFinding("version", ok=None, text=f"'{version}' is no release: volcal was tried with 2.9")
    release = (int(numbers[1]), int(numbers[2]))
    name = f"LinuxCNC {version}"
    if release < _SUPPORTED:
        text = f"{name} is older than 2.9, with which volcal was tried: upgrade, or expect a HAL pin to be missing"
        return DiagnosticFinding("version", ok=False, text=text)
    if release > _SUPPORTED:
        text = (
            f"{name} is newer than 2.9, with which volcal was tried: its HAL interface has changed. Build the "
            "components anew, and touch one ball with `volcal try` before anything else"
        )
        return DiagnosticFinding("version", ok=None, text=text)
    if int(numbers[3] or 0) < _PROBING_MENDED:
        text = (
            f"{name}: motion, probing and compensation. If touches end with 'Probe tripped during non-probe move', the "
            "contact bounces while the axes brake, which releases before 2.9.5 may take for a collision: upgrade, or "
            "hold the signal of the probe in HAL for longer than it bounces, with its first edge passed on at once"
        )
        return DiagnosticFinding("version", ok=True, text=text)
    return DiagnosticFinding("version", ok=True, text=f"{name}: motion, probing and compensation")


def _tables(store: LinuxCncStore | None) -> list[DiagnosticFinding]:
    if store is None:
        return [
            DiagnosticFinding("tables", ok=True, text="no compensation configured: another device must be the store")
        ]
    return store.diagnose()


def _heartbeats(watched: list[str]) -> DiagnosticFinding:
    """Report whether the loss of LinuxCNC's processes would be noticed."""
    missing = [part for part in ("task", "motion") if part not in watched]
    text = f"{', '.join(watched)} alive"
    if missing:
        text = f"{' and '.join(missing)} cannot be watched: if it stops, a motion ends only by its time limit"
    return DiagnosticFinding("heartbeats", ok=not missing, text=text)


def _latency(session: LinuxCncSession, first: Snapshot) -> DiagnosticFinding:
    """Report round-trip times, and the skew between LinuxCNC's clock and ours."""
    start_s = wall_seconds()
    before = session.read_snapshot()
    durations_s: list[float] = []
    for _ in range(LATENCY_READS):
        asked_s = wall_seconds()
        last = session.read_snapshot()
        durations_s.append(wall_seconds() - asked_s)
    passed_s = wall_seconds() - start_s
    skew_s = (last.monotonic_s - before.monotonic_s) - passed_s
    median_s, worst_s = sorted(durations_s)[len(durations_s) // 2], max(durations_s)
    text = f"median {median_s * 1e3:.2f} ms, worst {worst_s * 1e3:.2f} ms; clock skew {skew_s * 1e3:.2f} ms"
    return DiagnosticFinding(
        "latency", ok=median_s <= SLOW_ROUND_TRIP_S and abs(skew_s) <= worst_s + SKEW_LEAST_S, text=text
    )


def _state(snapshot: Snapshot) -> DiagnosticFinding:
    homed = "homed" if snapshot.homed else "not homed: home it at the machine, or see option homing"
    fault = snapshot.fault
    text = f"{snapshot.state.value}{': ' if fault else ''}{fault}, {homed}"
    return DiagnosticFinding("state", ok=not fault and snapshot.homed, text=text)


def _probe(session: LinuxCncSession, snapshot: Snapshot) -> DiagnosticFinding:
    expected = session.settings.probe_tool
    loaded = expected is None or snapshot.tool == expected
    healthy = session.probe_healthy(snapshot)
    pin = "tripped" if snapshot.deflected else "free"
    text = f"tool {snapshot.tool} in the spindle, motion.probe-input is {pin}{'' if healthy else ', not healthy'}"
    return DiagnosticFinding("probe", ok=loaded and healthy and not snapshot.deflected, text=text)


def _travel(session: LinuxCncSession) -> DiagnosticFinding:
    limits = session.properties.limits
    travel = ", ".join(
        f"{axis} {low:g} … {high:g} mm" for axis, low, high in zip(XYZ, limits.lower_mm, limits.upper_mm, strict=True)
    )
    return DiagnosticFinding("travel", ok=True, text=f"{travel}; 1 unit is {session.properties.mm_per_unit:g} mm")


def _joint_margin(session: LinuxCncSession) -> Iterator[DiagnosticFinding]:
    """Report whether the joints can move by the largest correction beyond the limits of their axes.

    A joint that reaches its limit ends the motion with an error. Only with three joints is it known that they are those
    of X, Y and Z.
    """
    compensation, limits = session.settings.compensation, session.properties.limits
    joints = session.link.hello["joint_limits"]
    if compensation is None or compensation.method == "comp-files" or len(joints) != len(XYZ):
        return
    mm = session.properties.mm_per_unit
    margins = [
        min(low - least * mm, most * mm - high)
        for low, high, (least, most) in zip(limits.lower_mm, limits.upper_mm, joints, strict=True)
    ]
    needed = compensation.max_correction_mm
    text = ", ".join(f"{axis} {margin:g} mm" for axis, margin in zip(XYZ, margins, strict=True))
    enough = min(margins) >= needed - LEAST_MARGIN_ERROR_MM
    yield DiagnosticFinding(
        "[JOINT_*] limits",
        ok=enough,
        text=f"beyond those of the axis: {text}" + ("" if enough else f"; corrections need up to {needed:g} mm"),
    )


def _overrides(snapshot: Snapshot) -> Iterator[DiagnosticFinding]:
    for name, value in (("feed override", snapshot.feed_override), ("rapid override", snapshot.rapid_override)):
        yield DiagnosticFinding(name, ok=value == 1.0, text=f"{100.0 * value:.0f} %")
    yield DiagnosticFinding(
        "work coordinates",
        ok=snapshot.rotation_deg == 0.0,
        text=f"rotated by {snapshot.rotation_deg:g}°" if snapshot.rotation_deg else "not rotated",
    )


def _ini(session: LinuxCncSession) -> Iterator[DiagnosticFinding]:
    """Report INI settings that make a calibration wrong or dangerous."""
    keys = [
        ("DISPLAY", "MAX_FEED_OVERRIDE"),
        *((f"AXIS_{axis}", "OFFSET_AV_RATIO") for axis in XYZ),
        *((f"JOINT_{number}", "HOME_ABSOLUTE_ENCODER") for number in range(session.link.hello["joints"])),
        *((f"JOINT_{number}", "HOME_SEARCH_VEL") for number in range(session.link.hello["joints"])),
    ]
    reported = session.link.ask("ini", keys=keys)["values"]
    values = dict(zip([f"[{section}]{key}" for section, key in keys], reported, strict=True))
    override = values["[DISPLAY]MAX_FEED_OVERRIDE"]
    yield DiagnosticFinding(
        "[DISPLAY]MAX_FEED_OVERRIDE",
        ok=override is None or _number(override) <= 1.0,
        text=f"{override}: up to this multiple of the programmed feed" if override else "not set",
    )
    period_s = session.properties.servo_period_s
    spread_um = 1e3 * LATCH_MM_PER_S * period_s
    yield DiagnosticFinding(
        "[EMCMOT]SERVO_PERIOD",
        ok=period_s <= LONGEST_PERIOD_S,
        text=f"{period_s * 1e3:g} ms: touches at {LATCH_MM_PER_S:g} mm/s latch up to {spread_um:.1f} µm late; half is "
        f"subtracted, ±{0.5 * spread_um:.1f} µm remain",
    )
    yield from _homing(values)
    ratios = [values[f"[AXIS_{axis}]OFFSET_AV_RATIO"] for axis in XYZ]
    yield DiagnosticFinding(
        "[AXIS_*]OFFSET_AV_RATIO",
        ok=True,
        text="none: external offsets have no effect"
        if not any(ratios)
        else f"{', '.join(str(ratio) for ratio in ratios)}",
    )


def _homing(values: dict[str, str | None]) -> Iterator[DiagnosticFinding]:
    """Report joints that have neither a home switch nor an absolute encoder; they home at their present position."""
    unreferenced = [
        place.removesuffix("HOME_SEARCH_VEL")
        for place, speed in values.items()
        if place.endswith("HOME_SEARCH_VEL")
        and _number(speed) == 0.0
        and values[place.replace("HOME_SEARCH_VEL", "HOME_ABSOLUTE_ENCODER")] not in ("1", "2")
    ]
    text = "joints home by a switch or an absolute encoder"
    if unreferenced:
        joints = ", ".join(unreferenced)
        text = f"{joints} without HOME_SEARCH_VEL and HOME_ABSOLUTE_ENCODER: homing takes any position as zero"
    yield DiagnosticFinding("homing", ok=not unreferenced, text=text)


def _temperatures(session: LinuxCncSession) -> DiagnosticFinding:
    pins = session.settings.temperatures
    if not pins:
        return DiagnosticFinding(
            "temperatures", ok=True, text="no HAL pins named: another device must be the thermometer"
        )
    values = session.link.get_all(list(pins.values()))
    reported = ", ".join(f"{name} {float(value):.2f} °C" for name, value in zip(pins, values, strict=True))
    return DiagnosticFinding("temperatures", ok=True, text=reported)


def _number(text: str | None) -> float:
    """Parse an INI number; 0.0 if the key is missing or not a number."""
    try:
        return float((text or "0").split("#")[0])
    except ValueError:
        return 0.0
