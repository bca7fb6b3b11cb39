"""Numbers in requests of the control channel."""

from __future__ import annotations

from typing import Any

from drivers.errors import InputError

LARGEST = 1e6
"""Largest absolute value of a length in mm or an angle in degrees: one kilometre, more than any machine has."""


def number(value: Any, key: str) -> float:
    """Return `value` if it is a finite number of at most `LARGEST`; `key` is its key in the request.

    Raises InputError otherwise.
    """
    # JSON allows NaN and integers that no float can hold: the comparison refuses both
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        shown = repr(value) if not isinstance(value, int) or abs(value) < 10**20 else "an integer of very many digits"
        raise InputError(f"{key} must be a number from {-LARGEST:.0f} to {LARGEST:.0f}, got {shown}", key=key)
    return float(value)
