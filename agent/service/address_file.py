"""Address file of the running service in the state directory. The HTTP endpoint writes the file, and the command-line
commands read it.

A service that was killed leaves its file behind, and any program can then listen at the address in it. The service
therefore keeps a lock on the file, which the operating system releases with the process. The commands, which send the
access token to the address, use it only while the process named in the file holds the lock.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final
from urllib.parse import quote

ADDRESS_FILE: Final = "service.json"
MAX_BYTES: Final = 4096
MACHINE_HEADER: Final = "Volcal-Machine"
"""Header with which a command says which machine it means (`machine_header`)."""
_FLOCK: Final = struct.Struct("hhqqi4x")
"""`struct flock` of fcntl(2): type, whence, start, length, process."""


def write_address(directory: Path, url: str) -> Callable[[], None]:
    """Write `url` to the address file and lock the file. Return a function that removes the file.

    Command-line commands use the file to find the service, which runs in this process. The file appears with its lock.
    """
    path = directory / ADDRESS_FILE
    staged = directory / f".{ADDRESS_FILE}.{os.getpid()}"
    file = staged.open("wb")
    try:
        staged.chmod(0o644)
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        file.write(json.dumps({"url": url, "process": os.getpid()}).encode())
        file.flush()
        staged.replace(path)
    except BaseException:
        staged.unlink(missing_ok=True)
        file.close()
        raise

    def remove() -> None:
        path.unlink(missing_ok=True)
        file.close()

    return remove


def machine_header(machine: Path) -> str:
    """Return the value of the header `MACHINE_HEADER` for the machine of the file `machine`, an absolute path."""
    return quote(os.fsencode(machine))


def read_address(directory: Path) -> str:
    """Return the URL of the running service from the address file.

    Raise FileNotFoundError if no service runs, also if one that was killed has left its file. Raise OSError, ValueError
    or KeyError if the file is invalid. The process that wrote the file must not call this function: it would lose its
    lock.
    """
    path = directory / ADDRESS_FILE
    with path.open("rb") as file:
        holder = _holder(file)
        if holder is None:
            raise FileNotFoundError(path)
        document: Any = json.loads(file.read(MAX_BYTES))
    if not isinstance(document, dict):
        raise ValueError("it contains no JSON object")
    if document["process"] != holder:
        raise FileNotFoundError(path)
    return str(document["url"])


def _holder(file: BinaryIO) -> int | None:
    """Return the number of the process that holds a lock on the file, or None if no other process holds one."""
    wanted = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    kind, _, _, _, process = _FLOCK.unpack(fcntl.fcntl(file, fcntl.F_GETLK, wanted))
    return None if kind == fcntl.F_UNLCK else process
