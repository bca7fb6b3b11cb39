"""What a version of LinuxCNC is good for: the releases with which volcal was tried, and what is known of the others."""

from __future__ import annotations

import re

from drivers.roles import DiagnosticFinding

_NUMBERS = re.compile(r"(\d+)\.(\d+)(?:\.(\d+))?")
_SUPPORTED = (2, 9)
_PROBING_MENDED = 5
"""Third number of the first release 2.9 that permits the contact of the probe to bounce while the axes brake."""


def version_finding(version: str) -> DiagnosticFinding:
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
