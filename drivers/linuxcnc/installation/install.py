"""Plan of the lines and files that `volcal linuxcnc install` adds to a machine, and of their removal.

The compensation is by external offsets, the method that leaves the machine's kinematics alone. It needs a HAL file
beside the INI file and seven lines in it: HALFILE in [HAL], the section [VOLCAL] with DIRECTORY, OFFSET_AV_RATIO in
[AXIS_X], [AXIS_Y] and [AXIS_Z], and HALFILE for the probe unless the machine has connected it. What is there already is
kept: the links of the HAL files tell which pins are connected to which signals, as far as the text of the files does.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from drivers.errors import InputError
from drivers.linuxcnc.installation.changes import FileChange, require_writable
from drivers.linuxcnc.installation.ini_file import IniFile
from drivers.linuxcnc.installation.kinematics import NamedKinematics, loaded_kinematics, notes_on

HALLIB = Path("/usr/share/linuxcnc/hallib")
"""Directory in which LinuxCNC searches for HAL files that are not beside the INI file."""
ARROWS = ("=>", "<=", "<=>")
COMPONENTS = Path(__file__).resolve().parents[1] / "components"
COMPENSATION_HAL = "volcal-eoffset.hal"
PROBE_HAL = "volcal-probe.hal"
OTHER_METHOD_HAL = "volcal-kins.hal"
OWN_FILES = (COMPENSATION_HAL, PROBE_HAL)
PROBE_INPUT = "motion.probe-input"
OFFSET_SHARE = "0.1"
"""Share of speed and acceleration of an axis that is reserved for its external offset."""
DEFAULT_DIRECTORY = Path("/var/lib/volcal/linuxcnc")
BACKUP = ".volcal-backup"
BUILT = (Path("/usr/lib/linuxcnc/modules/volcal_eoffset.so"), Path("/usr/bin/volcal_tables"))


@dataclass(frozen=True)
class Installation:
    """Changes of files, directory to be created (None if it exists), and notes for the user."""

    changes: list[FileChange]
    directory: Path | None
    notes: list[str]


def plan_installation(ini_path: Path, *, directory: Path | None, probe_pin: str | None) -> Installation:
    """Return what is missing for volcal in the configuration of a machine. Nothing is written.

    `directory` is for the compensation tables; `probe_pin` is the HAL pin of the probe, None if the machine has
    connected it. Raises InputError if the configuration cannot be changed safely.
    """
    before = _read(ini_path)
    ini = IniFile(ini_path, before)
    require_writable(ini_path)
    ini.without_marked_lines()  # raises if a mark is damaged
    _require_other_method_unused(ini)
    texts = _hal_texts(ini, ini_path)
    on_kinematics = _notes_on_kinematics(ini, texts)
    made = links(texts)
    text, notes = adapted((COMPONENTS / COMPENSATION_HAL).read_text(encoding="utf-8"), made)
    files = {COMPENSATION_HAL: text}
    notes += [*on_kinematics, *_probe(files, made, probe_pin)]
    tables = _add_entries(ini, files, directory)
    changes = [_own_file(ini_path.parent / name, content) for name, content in files.items()]
    if ini.content() != before:
        changes += [_backup(ini_path, before), FileChange(ini_path, before, ini.content())]
    notes += _still_to_do(ini, made, probe_pin)
    missing = not (ini_path.parent / tables).is_dir()
    return Installation(
        [c for c in changes if c.before != c.after], ini_path.parent / tables if missing else None, notes
    )


def plan_removal(ini_path: Path) -> Installation:
    """Return how what `install` has added is taken out again. Nothing is written."""
    before = _read(ini_path)
    ini = IniFile(ini_path, before)
    after = ini.without_marked_lines()
    if after == before:
        return Installation([], None, ["nothing to remove"])
    require_writable(ini_path)
    changes, notes = [FileChange(ini_path, before, after)], []
    for name in OWN_FILES:
        path = ini_path.parent / name
        if path.is_file() and not _is_named(IniFile(ini_path, after), name):
            changes.append(FileChange(path, path.read_bytes(), None))
    for backup in sorted(ini_path.parent.glob(f"{ini_path.name}{BACKUP}*")):
        if backup.read_bytes() == after:
            changes.append(FileChange(backup, after, None))
        else:
            notes.append(f"{backup} is kept: the configuration was changed since")
    notes.append("the compensation tables are kept; without these lines LinuxCNC corrects nothing")
    return Installation(changes, None, notes)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("there is no such file", hint="give the INI file of LinuxCNC", file=str(path)) from None
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", file=str(path)) from None


def _add_entries(ini: IniFile, files: dict[str, str], directory: Path | None) -> Path:
    """Add the missing entries, and return the directory of the tables."""
    for axis in "XYZ":
        section = ini.require_section(f"AXIS_{axis}", "volcal needs the axes X, Y and Z")
        ratio = ini.value(section, "OFFSET_AV_RATIO")
        if ratio is None:
            ini.insert_after(section.header, f"OFFSET_AV_RATIO = {OFFSET_SHARE}")
        elif not _is_share(ratio):
            raise InputError(
                f"OFFSET_AV_RATIO = {ratio} of axis {axis} leaves no speed for external offsets or none for motions",
                hint=f"set it to {OFFSET_SHARE}",
                file=str(ini.path),
                line=section.header + 1,
            )
    last = [index for index, key, _ in ini.entries(ini.require_section("HAL")) if key == "HALFILE"]
    if not last:
        raise InputError("[HAL] names no HALFILE, and one must load the motion", file=str(ini.path))
    missing = [f"HALFILE = {name}" for name in files if not _is_named(ini, name)]
    if missing:
        ini.insert_after(last[-1], *missing)
    return _add_directory(ini, directory)


def _add_directory(ini: IniFile, directory: Path | None) -> Path:
    section = ini.section("VOLCAL")
    told = None if section is None else ini.value(section, "DIRECTORY")
    if told is not None:
        if directory is not None and Path(told) != directory:
            raise InputError(
                f"[VOLCAL]DIRECTORY is {told}, not {directory}",
                hint="leave out --directory, or remove the installation first",
                file=str(ini.path),
            )
        return Path(told)
    chosen = directory or DEFAULT_DIRECTORY
    if section is None:
        ini.append("[VOLCAL]", f"DIRECTORY = {chosen}")
    else:
        ini.insert_after(section.header, f"DIRECTORY = {chosen}")
    return chosen


def _probe(files: dict[str, str], made: dict[str, Link], probe_pin: str | None) -> list[str]:
    """Add the HAL file of the probe if a pin is given, and return notes."""
    link = made.get(PROBE_INPUT)
    if probe_pin is None:
        return [f"the probe is the signal {link.signal} ({link.file}:{link.line})"] if link else []
    if link is not None:
        raise InputError(
            f"{PROBE_INPUT} is already connected to the signal {link.signal}",
            hint="leave out --probe-pin, or disconnect the other probe",
            file=link.file,
            line=link.line,
        )
    signal = made[probe_pin].signal if probe_pin in made else "volcal-probe"
    source = "" if probe_pin in made else f"{probe_pin} "
    files[PROBE_HAL] = f"# Touch probe of the machine, for G38 and volcal.\nnet {signal} {source}=> {PROBE_INPUT}\n"
    return []


def _own_file(path: Path, content: str) -> FileChange:
    """Return the change that writes one of volcal's files; a file of other content is refused."""
    before = path.read_bytes() if path.is_file() else None
    if before is not None and before != content.encode():
        raise InputError("this file exists with other content", hint="move it away; it is written anew", file=str(path))
    require_writable(path)
    return FileChange(path, before, content.encode())


def _backup(ini_path: Path, before: bytes) -> FileChange:
    """Return the change that keeps the INI file as it is, beside it, and overwrites no former backup."""
    number, path = 1, ini_path.with_name(ini_path.name + BACKUP)
    while path.is_file() and path.read_bytes() != before:
        number += 1
        path = ini_path.with_name(f"{ini_path.name}{BACKUP}-{number}")
    return FileChange(path, before if path.is_file() else None, before)


def _hal_texts(ini: IniFile, ini_path: Path) -> list[tuple[str, str]]:
    """Return the HAL commands of the machine without those of volcal, by file."""
    texts = []
    for index, key, value in ini.entries(ini.require_section("HAL")):
        if key == "HALCMD":
            texts.append((f"{ini_path} line {index + 1}", value))
        if key in ("HALFILE", "POSTGUI_HALFILE") and value not in OWN_FILES:
            path = hal_file(value, ini_path.parent, ini_path)
            if path is not None:
                texts.append((str(path), read_hal(path)))
    return texts


def _is_named(ini: IniFile, name: str) -> bool:
    entries = ini.entries(ini.require_section("HAL"))
    return any(key == "HALFILE" and Path(value).name == name for _, key, value in entries)


def _require_other_method_unused(ini: IniFile) -> None:
    kinematics = ini.section("KINS")
    told = "" if kinematics is None else ini.value(kinematics, "KINEMATICS") or ""
    if _is_named(ini, OTHER_METHOD_HAL) or told.startswith("volcal_kins"):
        raise InputError(
            "this machine already compensates in its kinematics (volcal_kins)",
            hint="one method is enough; use method = 'kinematics' in volcal's settings",
            file=str(ini.path),
        )


def _notes_on_kinematics(ini: IniFile, texts: list[tuple[str, str]]) -> list[str]:
    """Return notes on the kinematics. Raises InputError if they are not those of three slides."""
    section = ini.section("KINS")
    named = (
        [] if section is None else [entry for entry in ini.entries(section) if entry[1] == "KINEMATICS" and entry[2]]
    )
    in_ini = [NamedKinematics(value, str(ini.path), index + 1) for index, _, value in named[:1]]
    found = [*in_ini, *loaded_kinematics(texts)]
    if not found:
        return ["the kinematics are not named in the INI file or its HAL files: only three slides can be compensated"]
    return [note for kinematics in found for note in notes_on(kinematics)]


def _still_to_do(ini: IniFile, made: dict[str, Link], probe_pin: str | None) -> list[str]:
    """Return what a person must decide or do, because it depends on the machine."""
    notes = []
    if any(not path.exists() for path in BUILT):
        notes.append(f"before LinuxCNC starts again, build the components: sudo make -C {COMPONENTS} install")
    if probe_pin is None and PROBE_INPUT not in made:
        notes.append(f"nothing is connected to {PROBE_INPUT}: give the pin of the probe with --probe-pin")
    display = ini.section("DISPLAY")
    override = None if display is None else ini.value(display, "MAX_FEED_OVERRIDE")
    if override not in (None, "1", "1.0"):
        notes.append(f"[DISPLAY]MAX_FEED_OVERRIDE is {override}: leave the override at 100 % while volcal measures")
    notes.append("widen the soft limits by the largest correction where the mechanics allow it, see the how-to")
    return notes


def _is_share(text: str) -> bool:
    try:
        return 0.0 < float(text) < 1.0
    except ValueError:
        return False


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
