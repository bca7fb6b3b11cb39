"""Interface through which a compensation store reads and sets HAL pins; the bridge link implements it."""

from __future__ import annotations

from typing import Protocol

PinValue = bool | int | float


class Pins(Protocol):
    """HAL pins, signals and parameters of the running LinuxCNC, by name.

    Errors: `CommandRejected` if HAL has no such name, the value does not fit its type, or it cannot be set
    (an output, or linked to a signal that another component writes); `where` names the pin. `LinkLost` if
    LinuxCNC or the bridge is gone, `LinkTimeout` if no answer comes. Both operations are idempotent.
    """

    def get(self, name: str) -> PinValue:
        """Return the value: bit as bool, s32 and u32 as int, float as float."""
        ...

    def set(self, name: str, value: PinValue) -> None:
        """Set an undriven pin (as `halcmd setp`), or the signal it is linked to if that has no writer (as `sets`)."""
        ...
