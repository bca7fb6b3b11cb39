"""Parameters in which the controller shows its state: positions, offsets and modes. Lengths are in the unit of the
program for positions, and in mm for offsets, as on a metric machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from gcode.flattening.parameters import Key
from gcode.modal import ModalState
from gcode.setup import SYSTEMS, Triple
from gcode.source import SourceLine

# Numbers of the parameters in LinuxCNC: position from 5420, offsets from 5221 in blocks of 20, G92 from 5210, tool from
# 5400.
_POSITION, _SYSTEM, _G92_ACTIVE, _TOOL = 5420, 5220, 5210, 5400
_FIRST_OFFSET, _OFFSET_STEP = 5221, 20
_AXES = 9
_HIDDEN = range(5001, 5603)


class SystemParameters:
    """Values of the system parameters, taken from the modal state `modal` at the time of reading.

    `returned` is the value that the last subroutine returned, or None if it returned none.
    """

    def __init__(self, modal: ModalState) -> None:
        self._modal = modal
        self.returned: float | None = None
        self._names: dict[str, Callable[[], float]] = {
            "_metric": lambda: float(modal.unit_mm == 1.0),
            "_imperial": lambda: float(modal.unit_mm != 1.0),
            "_absolute": lambda: float(modal.absolute),
            "_incremental": lambda: float(not modal.absolute),
            "_inverse_time": lambda: float(modal.inverse_time),
            "_plane": lambda: float(modal.plane),
            "_coord_system": lambda: 10.0 * float(modal.system[1:]),
            "_ccomp": lambda: 400.0,
            "_task": lambda: 1.0,
            "_value": lambda: self.returned or 0.0,
            "_value_returned": lambda: float(self.returned is not None),
            **dict.fromkeys(("_a", "_b", "_c", "_u", "_v", "_w"), lambda: 0.0),
        }

    def value(self, key: Key, source: SourceLine) -> float | None:
        """Return the value of a system parameter, or None for any other. Raises FormatError if it is not known."""
        return self._named(key, source) if isinstance(key, str) else self._numbered(key, source)

    def _numbered(self, key: int, source: SourceLine) -> float | None:  # noqa: PLR0911  one return for each range
        modal = self._modal
        if _POSITION <= key < _POSITION + _AXES:
            return program_position(modal, source)[key - _POSITION] if key < _POSITION + 3 else 0.0
        if key == _SYSTEM:
            return float(SYSTEMS.index(modal.system) + 1)
        if _FIRST_OFFSET <= key < _FIRST_OFFSET + _OFFSET_STEP * len(SYSTEMS):
            number, axis = divmod(key - _FIRST_OFFSET, _OFFSET_STEP)
            return _of(modal.work_offsets.get(SYSTEMS[number]), axis, f"the work offset {SYSTEMS[number]}", source)
        if _G92_ACTIVE <= key < _G92_ACTIVE + 1 + _AXES:
            return float(any(modal.g92)) if key == _G92_ACTIVE else _of(modal.g92, key - _G92_ACTIVE - 1, "", source)
        if key == _TOOL and modal.tool_held is not None:
            return float(modal.tool_held)
        if _TOOL < key <= _TOOL + _AXES:
            return _of(modal.tool_offset, key - _TOOL - 1, "", source)
        if key in _HIDDEN:
            source.refuse(f"the value of #{key} is known only to the controller (probe results, inputs, tool data)")
        return None

    def _named(self, name: str, source: SourceLine) -> float | None:
        if name in ("_x", "_y", "_z"):
            return program_position(self._modal, source)["xyz".index(name[1])]
        if name == "_line":
            return float(source.number)
        if name == "_current_tool":
            return None if self._modal.tool_held is None else float(self._modal.tool_held)
        if name.startswith(("_ini[", "_hal[")):
            source.refuse(f"#<{name}> is known only to the controller")
        found = self._names.get(name)
        return None if found is None else found()


def program_position(modal: ModalState, source: SourceLine) -> Triple:
    """Return the position in the coordinates and the unit of the program. Raises FormatError if it is not known."""
    if modal.offset is None:
        name = modal.system
        source.refuse(f"the work offset {name} is not known", f"Give it: --work-offset {name}=X,Y,Z")
    if any(map(math.isnan, modal.position)):
        source.refuse("the position of the axes at this line is not known", modal.start_hint)
    x, y, z = ((at - zero) / modal.unit_mm for at, zero in zip(modal.position, modal.offset, strict=True))
    return x, y, z


def _of(offset: Triple | None, axis: int, name: str, source: SourceLine) -> float | None:
    if offset is None:
        source.refuse(f"{name} is not known", f"Give it: --{name.removeprefix('the ').replace(' ', '-', 1)}=X,Y,Z")
    return offset[axis] if axis < len(offset) else 0.0
