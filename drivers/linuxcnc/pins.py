"""Interface through which a compensation store reads and sets HAL pins; the bridge link implements it."""

from __future__ import annotations

from typing import Protocol

PinValue = bool | int | float


class Pins(Protocol):
    """HAL pins, signals and parameters of the running LinuxCNC, by name.

    Both methods are idempotent. They raise `CommandRejected`, with the pin in `where`, if HAL has no such name, if the
    value does not fit the type, or if the pin cannot be set (it is an output, or linked to a signal that another
    component writes). They raise `LinkLost` if LinuxCNC or the bridge has ended, and `LinkTimeout` if no answer comes.
    """

    def get(self, name: str) -> PinValue:
        """Return the value: bit as bool, s32 and u32 as int, float as float."""
        ...

    def set(self, name: str, value: PinValue) -> None:
        """Set a pin, as `halcmd setp` does.

        If the pin is linked to a signal that no pin writes, set that signal, as `halcmd sets` does.
        """
        ...
