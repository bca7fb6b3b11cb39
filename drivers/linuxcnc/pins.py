"""Interface through which a compensation store reads and sets pins of HAL, the hardware abstraction layer of LinuxCNC.

The link to the bridge process implements this interface.
"""

from __future__ import annotations

from typing import Protocol

PinValue = bool | int | float


class Pins(Protocol):
    """HAL pins, signals and parameters of the running LinuxCNC, accessed by name.

    The methods `get` and `set` are idempotent. They raise `CommandRejected`, with the pin in `where`, if HAL has no
    such name or if the value does not fit the type of the pin. `set` also raises `CommandRejected` for a pin that
    cannot be set, because it is an output or is linked to a signal that another component writes. Both methods raise
    `LinkLost` if LinuxCNC or the bridge has ended, and `LinkTimeout` if no answer comes.
    """

    def get(self, name: str) -> PinValue:
        """Return the value of a HAL pin: a bit as bool, an s32 or u32 as int, a float as float."""
        ...

    def set(self, name: str, value: PinValue) -> None:
        """Set a HAL pin, as the command `halcmd setp` does.

        If the pin is linked to a signal that no other pin writes, set this signal, as the command `halcmd sets` does.
        """
        ...
