"""Atomic and durable writing of files. After a power cut, a file has its complete old or its complete new contents."""

from __future__ import annotations

import os
from pathlib import Path

from drivers.errors import StoreError
from drivers.foreign_errors import cause_of


def write_atomically(path: Path, text: str) -> None:
    """Write `text` to a temporary file, sync this file, and rename it to `path`.

    Raises StoreError if writing or syncing fails. In this case `path` holds its complete old or complete new contents.
    """
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
            f"cannot write {path}: {cause_of(error)}", hint="check the disk and the permissions of the directory"
        ) from error


def read_if_exists(path: Path) -> str | None:
    """Return the text of the file, or None if there is no file. Bytes that are not ASCII become surrogate escapes.

    Raises StoreError if the file cannot be read.
    """
    try:
        return path.read_bytes().decode("ascii", "surrogateescape")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise StoreError(
            f"cannot read {path}: {cause_of(error)}", hint="check the permissions of the directory"
        ) from error


def sync_directory(folder: Path) -> None:
    """Sync the directory `folder` to the disk. Earlier renames of files in this directory then survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
