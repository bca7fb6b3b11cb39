"""Files that are whole or not there, also across a power cut."""

from __future__ import annotations

import os
from pathlib import Path

from drivers.errors import StoreError


def write_atomically(path: Path, text: str) -> None:
    """Beside it, made durable, then put in its place. StoreError where the disk refuses; the old file stays."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("w", encoding="ascii", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_directory(path.parent)
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error.strerror}", hint="check the disk and the rights of the directory"
        ) from error


def read_if_exists(path: Path) -> str | None:
    """The text, bytes that are none kept as they are; None where there is no file."""
    try:
        return path.read_bytes().decode("ascii", "surrogateescape")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", hint="check the rights of the directory") from error


def sync_directory(folder: Path) -> None:
    """Renames in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
