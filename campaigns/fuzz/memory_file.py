"""File and folder in memory for the inputs of one decoder: new ones for each would take longer than the decoder."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from benchmarks.places import memory_root

Found = TypeVar("Found")


class MemoryFile:
    """File without a name, which only its owner can read, and which ends with the process."""

    def __init__(self) -> None:
        self._handle = os.memfd_create("volcal-fuzz")
        os.fchmod(self._handle, 0o600)

    def holding(self, data: bytes) -> Path:
        """Return the path at which this process finds the file, which now contains `data`."""
        os.ftruncate(self._handle, 0)
        os.pwrite(self._handle, data, 0)
        return Path(f"/proc/self/fd/{self._handle}")


class MemoryFolder:
    """Folder in memory, which ends with its owner. Only the user can read its files."""

    def __init__(self) -> None:
        self._path = Path(tempfile.mkdtemp(prefix="volcal-fuzz-", dir=memory_root()))
        weakref.finalize(self, shutil.rmtree, self._path, ignore_errors=True)

    def reading(self, files: Mapping[str, bytes], read: Callable[[Path], Found]) -> Found:
        """Return `read(folder)` while the folder contains these files, by name, and nothing else."""
        for name, data in files.items():
            (self._path / name).touch(mode=0o600)
            (self._path / name).write_bytes(data)
        try:
            return read(self._path)
        finally:
            self._clear()

    def _clear(self) -> None:
        for entry in self._path.iterdir():
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()
