"""Parameters (variables) of a part program: numbered (`#100`), named (`#<depth>`) and global (`#<_depth>`).

The parameters 1 to 30 and the named ones belong to a call of a subroutine; the others belong to the whole program. A
parameter that the program has not set has the value that earlier programs left in the controller. It is therefore
refused unless its value is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from gcode.source import SourceLine

Key = int | str
SystemValue = Callable[[Key, SourceLine], float | None]

LOCAL_NUMBERS = range(1, 31)
# Numbers above 5000 belong to the controller; 5599 is the exception that programs may set (it switches DEBUG messages
# on and off).
_LARGEST_FREE = 5000
_SHOWS_DEBUG = 5599


@dataclass(slots=True)
class _Scope:
    numbers: dict[Key, float] = field(default_factory=dict)
    names: dict[Key, float] = field(default_factory=dict)


class ProgramParameters:
    """Values of the parameters while a part program is interpreted.

    `given` contains values that the controller has before the program, by number (`100`) or name (`_depth`).
    `system_value` returns the value of a parameter in which the controller shows its state, or None for any other
    parameter.
    """

    def __init__(self, given: Mapping[str, float], system_value: SystemValue) -> None:
        self._system_value = system_value
        self._scopes = [_Scope()]
        self._globals: dict[Key, float] = {}
        for name, value in given.items():
            key: Key = int(name) if name.isdecimal() else name.lower()
            self._place(key)[key] = value

    def read(self, key: Key, source: SourceLine) -> float:
        """Return the value of a parameter. Raises FormatError if it is not known."""
        value = self.find(key, source)
        if value is None:
            name = _shown(key)
            message = f"the value of {name} is not known, because this program does not set it before this line"
            source.refuse(message, f"Give the value in the controller: --parameter {name.strip('#<>')}=VALUE")
        return value

    def find(self, key: Key, source: SourceLine) -> float | None:
        """Return the value of a parameter, or None if the program has not set it."""
        value = self._place(key).get(key)
        return self._system_value(key, source) if value is None else value

    def assign(self, key: Key, value: float, source: SourceLine) -> None:
        """Set a parameter. Raises FormatError if it belongs to the controller."""
        if isinstance(key, int) and not 1 <= key <= _LARGEST_FREE and key != _SHOWS_DEBUG:
            message = f"#{key} belongs to the controller (offsets, positions, probe results)"
            source.refuse(message, "Set work offsets with G10 L2, or use a parameter from 1 to 5000")
        self._place(key)[key] = value

    def enter(self, arguments: Sequence[float]) -> None:
        """Begin a subroutine call. The parameters 1 to 30 are its arguments, and 0 where there is none."""
        scope = _Scope(dict.fromkeys(LOCAL_NUMBERS, 0.0))
        scope.numbers.update(enumerate(arguments, start=1))
        self._scopes.append(scope)

    def enter_shared(self) -> None:
        """Begin a call by M98, which shares the parameters 1 to 30 with its caller."""
        self._scopes.append(_Scope(self._scopes[-1].numbers))

    def leave(self) -> None:
        """End the innermost call."""
        self._scopes.pop()

    def _place(self, key: Key) -> dict[Key, float]:
        if isinstance(key, int):
            return self._scopes[-1].numbers if key in LOCAL_NUMBERS else self._globals
        return self._globals if key.startswith("_") else self._scopes[-1].names


def _shown(key: Key) -> str:
    return f"#{key}" if isinstance(key, int) else f"#<{key}>"
