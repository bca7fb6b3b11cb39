"""Feed hold through HAL, for a machine whose task has stopped while its motion still runs.

Without its task LinuxCNC accepts no abort, but its motion still reads the pins of the feed hold: at zero feed the axes
come to rest along their path. The hold is the signal `volcal-hold`, so that a person sees in HAL who holds the machine,
and that it can be released later by another process.

The module runs in the Python interpreter of the Linux distribution.
"""

from __future__ import annotations

from typing import Any

import hal
from heartbeat import halcmd

SIGNAL = "volcal-hold"
PINS = ("motion.feed-inhibit", "motion.feed-hold")
"""Pins of the motion, best first: a program can switch off the second with M53 P0."""


def hold() -> bool:
    """Hold the feed; return False if another signal drives both pins."""
    if not _exists():
        free = [pin for pin in PINS if not _linked(pin)]
        if not free:
            return False
        halcmd("newsig", SIGNAL, "bit")
        halcmd("linkps", free[0], SIGNAL)
    halcmd("sets", SIGNAL, "1")
    return held()


def held() -> bool:
    """Return True if the feed is held by volcal."""
    try:
        return bool(hal.get_value(SIGNAL))
    except (RuntimeError, TypeError):
        return False


def release() -> None:
    halcmd("sets", SIGNAL, "0")


def _exists() -> bool:
    return any(signal["NAME"] == SIGNAL for signal in _signals())


def _linked(pin: str) -> bool:
    """Return True if a HAL pin is linked to a signal, or if it cannot be found."""
    for words in map(str.split, halcmd("-s", "show", "pin", pin).splitlines()):
        if len(words) >= 5 and words[4] == pin:
            return len(words) > 5
    return True


def _signals() -> list[dict[str, Any]]:
    signals: list[dict[str, Any]] = hal.get_info_signals()
    return signals
