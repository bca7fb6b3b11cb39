"""Links of a machine's HAL files: which pins are linked to which signals, as far as the text of the files tells."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from drivers.errors import InputError

HALLIB = Path("/usr/share/linuxcnc/hallib")
"""Directory in which LinuxCNC searches for HAL files that are not beside the INI file."""
ARROWS = ("=>", "<=", "<=>")


class Link(NamedTuple):
    """Link of a pin to a signal, and the line of a file that makes it."""

    signal: str
    file: str
    line: int


def links(texts: Iterable[tuple[str, str]]) -> dict[str, Link]:
    """Return the links that the HAL commands of several texts make, by pin. A text is given with the name of its file.

    The commands `net`, `linkps`, `linksp` and `linkpp` are understood, also in Tcl files; a name that a Tcl variable
    gives is not.
    """
    found: dict[str, Link] = {}
    for file, text in texts:
        for number, line in enumerate(text.splitlines(), start=1):
            words = [word for word in line.partition("#")[0].split() if word not in ARROWS]
            if len(words) < 2:
                continue
            command, first, *others = words
            if command == "net":
                found.update((pin, Link(first, file, number)) for pin in others)
            elif command in ("linkps", "linkpp") and others:
                found[first] = Link(others[0], file, number)
            elif command == "linksp" and others:
                found[others[0]] = Link(first, file, number)
    return found


def hal_file(name: str, beside: Path, ini: Path) -> Path | None:
    """Return the path of a HAL file that an INI file names, or None for a file that is only known at the start.

    Raises InputError if there is no such file.
    """
    word = name.partition(" ")[0]
    if not word or "$" in word:
        return None
    library = word.startswith("LIB:")
    word = word.removeprefix("LIB:")
    places = [HALLIB / word] if library else [beside / Path(word).expanduser(), HALLIB / word]
    for place in places:
        if place.is_file():
            return place
    raise InputError(f"HALFILE {word} does not exist", hint="LinuxCNC would not start either", file=str(ini))


def read_hal(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8", "replace")
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", file=str(path)) from None


def adapted(hal: str, made: Mapping[str, Link]) -> tuple[str, list[str]]:
    """Return the text of one of volcal's HAL files for a machine whose files make the links `made`.

    A pin can be linked to one signal only. If an output that volcal reads is linked already, volcal reads the signal of
    the machine; the second part of the result says so. Raises InputError if an input that volcal sets is in use.
    """
    lines, notes = [], []
    for line in hal.splitlines(keepends=True):
        told = re.match(r"net \S+ (\S+) => (.*)", line)
        if told is None:
            lines.append(line)
            continue
        source, targets = told.groups()
        for pin in targets.split():
            if pin in made:
                link = made[pin]
                raise InputError(
                    f"{pin}, which volcal must set, is already linked to the signal {link.signal}",
                    hint="nothing else may use it; disconnect it first",
                    file=link.file,
                    line=link.line,
                )
        if source in made:
            link = made[source]
            lines.append(f"net {link.signal} => {targets}\n")
            notes.append(f"{source} is read from the signal {link.signal} ({link.file}:{link.line})")
        else:
            lines.append(line)
    return "".join(lines), notes
