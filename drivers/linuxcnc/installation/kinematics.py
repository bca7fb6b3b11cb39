"""Kinematics of a machine as its configuration names them: which of them can be compensated in X, Y and Z.

volcal identifies the errors of three slides, X, Y and Z, and LinuxCNC adds an external offset to each of these axes. On
a machine whose joints are no slides along the axes, such as a robot, a hexapod or a five-axis head, the errors of a
joint appear in all axes, and a table over X, Y and Z holds for one posture only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from drivers.errors import InputError

SLIDES = "trivkins"
_BELTS = "corexykins"
_LOADED = re.compile(r"^\s*loadrt\s+(\w[\w-]*kins\w*|millturn)\b(.*)")
_COORDINATES = re.compile(r"\bcoordinates\s*=\s*(\w+)", re.IGNORECASE)


class NamedKinematics(NamedTuple):
    """Kinematics that a file names, with their parameters, and the line of the file."""

    text: str
    file: str
    line: int

    @property
    def name(self) -> str:
        return self.text.split()[0]


def loaded_kinematics(texts: Iterable[tuple[str, str]]) -> list[NamedKinematics]:
    """Return the kinematics that HAL commands load by name. A text is given with the name of its file."""
    found = []
    for file, text in texts:
        for number, line in enumerate(text.splitlines(), start=1):
            match = _LOADED.match(line.partition("#")[0])
            if match is not None:
                found.append(NamedKinematics(f"{match[1]} {match[2]}", file, number))
    return found


def notes_on(kinematics: NamedKinematics) -> list[str]:
    """Return what a user must know about the kinematics. Raises InputError if they cannot be compensated."""
    if kinematics.name == _BELTS:
        return [
            f"{_BELTS}: two motors move X and Y together; the table corrects X, Y and Z of the tool, not the motors, "
            "and stretch of the belts that changes with load or acceleration is not in it"
        ]
    if kinematics.name != SLIDES:
        raise InputError(
            f"volcal cannot compensate a machine with the kinematics {kinematics.name}: its errors are not those of "
            "three slides X, Y and Z",
            hint=f"{SLIDES} is supported, with X, Y and Z and any further axes",
            file=kinematics.file,
            line=kinematics.line,
        )
    named = _COORDINATES.search(kinematics.text)
    others = sorted(set(named[1].upper()) - set("XYZ")) if named else []
    if not others:
        return []
    axes = f"the axis {others[0]} is" if len(others) == 1 else f"the axes {', '.join(others[:-1])} and {others[-1]} are"
    return [
        f"{axes} not compensated: the table corrects X, Y and Z, and holds for the positions of the other axes at "
        "which it was measured"
    ]
