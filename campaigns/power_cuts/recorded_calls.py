"""System calls of a process that change files, recorded by strace."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

STRACE = "strace"
TRACED = (
    "openat,open,creat,mkdir,mkdirat,write,pwrite64,writev,pwritev,pwritev2,ftruncate,truncate,fallocate,fsync,fdatasync,"
    "sync_file_range,msync,unlink,unlinkat,rename,renameat,renameat2,link,linkat,symlink,sendfile,copy_file_range"
)
REMOVING = ("unlink", "unlinkat", "rename", "renameat", "renameat2")
OUTPUT = 1
TIMEOUT_S = 300.0
_CALL = re.compile(r"^(?P<name>\w+)\((?P<arguments>.*)\)\s+= (?P<result>-?\d+)")
_DESCRIPTOR = re.compile(r"^(\d+)<([^>]*)>")
_QUOTED = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')


@dataclass(frozen=True)
class Written:
    path: str
    offset: int
    data: bytes


@dataclass(frozen=True)
class Truncated:
    path: str
    size: int


@dataclass(frozen=True)
class Synced:
    """Return of a call that waits until a file or the entries of a directory are on the disk."""

    path: str


@dataclass(frozen=True)
class Created:
    """New file, or new directory if `directory` is True."""

    path: str
    directory: bool = False


@dataclass(frozen=True)
class Removed:
    path: str


@dataclass(frozen=True)
class Renamed:
    path: str
    target: str


@dataclass(frozen=True)
class Acknowledged:
    """Line that the process has written to its standard output: what it acknowledges, and which one."""

    kind: str
    value: str


FileCall = Written | Truncated | Synced | Created | Removed | Renamed | Acknowledged


def recorded_calls(directory: Path, arguments: list[str], log: Path) -> list[FileCall]:
    """Run `python ARGUMENTS` and return its system calls that concern files below `directory`, in order.

    `log` is the file to which strace writes. Raises RuntimeError if the process or strace fails, or if the process
    changes files in a way that is not known here.
    """
    traced = [STRACE, "-y", "-xx", "-s", "100000000", "-e", f"trace={TRACED}", "-o", str(log)]
    command = [*traced, sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, timeout=TIMEOUT_S, check=False)  # noqa: S603  our own module
    if done.returncode != 0:
        raise RuntimeError(f"the traced process failed: {done.stderr.decode()[-500:]}")
    calls = list(_read(log, str(directory)))
    told = [f"{one.kind} {one.value}" for one in calls if isinstance(one, Acknowledged)]
    if told != done.stdout.decode().splitlines():
        raise RuntimeError("the recorded calls are not complete: acknowledgements are missing")
    return calls


def works(directory: Path) -> bool:
    """Return True if processes can be traced on this computer."""
    try:
        command = [STRACE, "-o", str(directory / "probe"), sys.executable, "-c", ""]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0  # noqa: S603  as above
    except OSError:
        return False


def _read(log: Path, directory: str) -> Iterator[FileCall]:
    ends: dict[int, int] = {}
    known: set[str] = set()
    for line in log.read_text().splitlines():
        found = _CALL.match(line)
        if found is None or int(found["result"]) < 0:
            continue
        yield from _calls(found["name"], found["arguments"], int(found["result"]), directory, known, ends)


def _calls(
    name: str, arguments: str, result: int, directory: str, known: set[str], ends: dict[int, int]
) -> Iterator[FileCall]:
    descriptor = _DESCRIPTOR.match(arguments)
    number, path = (int(descriptor[1]), _text(descriptor[2])) if descriptor else (-1, "")
    quoted = [_bytes(one) for one in _QUOTED.findall(arguments)]
    if name == "write" and number == OUTPUT:
        kind, _, value = quoted[0].decode().rstrip("\n").partition(" ")
        yield Acknowledged(kind, value)
        return
    paths = [path] if path and name not in ("openat", "mkdirat", "unlinkat", "renameat", "renameat2") else []
    paths = paths or [one.decode() for one in quoted]
    if not paths or not paths[0].startswith(directory):
        return
    if name in ("write", "openat", "open"):
        yield from _at_an_end(name, arguments, result, paths[0], quoted[0], known, ends)
        return
    known.difference_update(paths[:1] if name in REMOVING else ())
    known.update(paths[1:] if name in REMOVING else ())
    match name:
        case "mkdir" | "mkdirat":
            yield Created(paths[0], directory=True)
        case "pwrite64":
            yield Written(path, int(arguments.rsplit(", ", 1)[1]), quoted[0][:result])
        case "ftruncate":
            yield Truncated(path, int(arguments.rsplit(", ", 1)[1]))
        case "fsync" | "fdatasync":
            yield Synced(path)
        case "unlink" | "unlinkat":
            yield Removed(paths[0])
        case "rename" | "renameat" | "renameat2":
            yield Renamed(paths[0], paths[1])
        case _:
            raise RuntimeError(f"the process has changed files by {name}, which is not known here")


def _at_an_end(
    name: str, arguments: str, result: int, path: str, data: bytes, known: set[str], ends: dict[int, int]
) -> Iterator[FileCall]:
    """Yield the opening of a file, or a write at the place where the one before has ended (`ends`, by descriptor)."""
    if name == "write":
        number = int(arguments.partition("<")[0])
        yield Written(path, ends[number], data[:result])
        ends[number] += result
        return
    ends[result] = 0
    if "O_CREAT" in arguments and path not in known:
        known.add(path)
        yield Created(path)
    elif "O_TRUNC" in arguments:
        yield Truncated(path, 0)


def _bytes(escaped: str) -> bytes:
    return bytes.fromhex(escaped.replace("\\x", ""))


def _text(escaped: str) -> str:
    return _bytes(escaped).decode() if "\\x" in escaped else escaped
