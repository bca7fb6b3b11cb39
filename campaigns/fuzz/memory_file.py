"""File in memory for the inputs of one decoder: a file on the disk for each would take longer than the decoder."""

from __future__ import annotations

import os
from pathlib import Path


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
