"""Access by name to the pins, signals and parameters of HAL, the hardware abstraction layer of LinuxCNC.

The module runs in the Python interpreter of the Linux distribution.
"""

from __future__ import annotations

import subprocess
from typing import Union

import hal

Value = Union[bool, int, float]  # noqa: UP007  the distribution may have Python 3.9
HALCMD_WITHIN_S = 2.0


class NoSuchPinError(Exception):
    """Error for a name that HAL does not have, or for a HAL pin that cannot be set to the given value."""


class HalPins:
    """Access to the HAL pins, signals and parameters of the running LinuxCNC.

    HAL requires that the calling process has created a HAL component.
    """

    def get(self, name: str) -> Value:
        """Return the value of a HAL pin: a bit as bool, an s32 or u32 as int, a float as float."""
        try:
            value: Value = hal.get_value(name)
            return value
        except (RuntimeError, TypeError) as error:
            raise NoSuchPinError(f"HAL has no pin, signal or parameter {name}") from error

    def values(self, *names: str) -> list[Value]:
        return [self.get(name) for name in names]

    def set(self, name: str, value: Value) -> None:
        """Set a HAL pin, as the command `halcmd setp` does.

        If the pin is linked to a signal that no other pin writes, set this signal, as the command `halcmd sets` does.
        """
        self.get(name)
        text = str(int(value)) if isinstance(value, bool) else repr(value)
        signal = self._signal(name)
        if signal is not None:
            self._halcmd("-s", "sets", signal, text)
            return
        try:
            hal.set_p(name, text)
        except (RuntimeError, TypeError) as error:
            raise NoSuchPinError(f"{name} cannot be set to {text}: {error}") from error

    def _signal(self, name: str) -> str | None:
        """Return the signal to which pin `name` is linked, or `name` itself if it is a signal."""
        if any(signal["NAME"] == name for signal in hal.get_info_signals()):
            return name
        for line in self._halcmd("-s", "show", "pin", name).splitlines():
            words = line.split()
            if len(words) == 7 and words[4] == name:
                return words[6]
        return None

    def _halcmd(self, *words: str) -> str:
        try:
            done = subprocess.run(  # noqa: S603  fixed program, no shell
                ["/usr/bin/halcmd", *words], capture_output=True, text=True, timeout=HALCMD_WITHIN_S, check=False
            )
        except subprocess.TimeoutExpired as late:
            raise NoSuchPinError(f"halcmd {' '.join(words)} did not end within {HALCMD_WITHIN_S:g} s") from late
        if done.returncode != 0:
            raise NoSuchPinError((done.stderr or done.stdout).strip() or f"halcmd {' '.join(words)} failed")
        return done.stdout
