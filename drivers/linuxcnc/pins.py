"""How a compensation store reads and sets HAL pins; whoever talks to LinuxCNC (the bridge) plays it."""

from __future__ import annotations

from typing import Protocol

PinValue = bool | int | float


class Pins(Protocol):
    """HAL pins, signals and parameters of the running LinuxCNC, by name.

    Errors: `CommandRejected` where HAL has no such name, the value does not fit its type, or it cannot be set
    (an output, or linked to a signal that another component writes); `where` names the pin. `LinkLost` where
    LinuxCNC or the bridge is gone, `LinkTimeout` where no answer comes. Both operations are idempotent.
    """

    def get(self, name: str) -> PinValue:
        """bit as bool, s32 and u32 as int, float as float."""
        ...

    def set(self, name: str, value: PinValue) -> None:
        """Sets a pin that nothing drives (as `halcmd setp`), or the signal that it is linked to where nothing
        writes that (as `sets`)."""
        ...
