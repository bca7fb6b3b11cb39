"""Points at which a process kills itself with SIGKILL, as many of them ahead as its parent has asked for."""

from __future__ import annotations

import mmap
import os
import signal
import threading
from struct import Struct

_HEAD = Struct("<qqq")
_SIZE, _TEXT_AT = 4096, _HEAD.size


class DeathPoint:
    """Memory that a process shares with the children it forks. The parent arms it, a child calls `passed` at each
    possible point, and dies at the one at which the armed number is used up.

    It is a mapping without a file, so that nothing is left to write when the child dies.
    """

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, _SIZE)
        self._lock = threading.Lock()

    def arm(self, ahead: int) -> None:
        """Let the child die once points of the weight `ahead` have been passed; 0 lets it live."""
        self._write(ahead, 0, 0)

    def passed(self, point: str, weight: int = 1) -> None:
        """Pass a point, whose name is kept for the parent if the child dies at it."""
        with self._lock:
            ahead, count, _ = _HEAD.unpack_from(self._memory)
            if ahead <= 0:
                return
            if ahead > weight:
                self._write(ahead - weight, count + 1, 0)
                return
            text = point.encode()[: _SIZE - _TEXT_AT]
            self._memory[_TEXT_AT : _TEXT_AT + len(text)] = text
            self._write(0, count + 1, len(text))
            os.kill(os.getpid(), signal.SIGKILL)

    @property
    def count(self) -> int:
        """Number of points passed since it was armed."""
        return int(_HEAD.unpack_from(self._memory)[1])

    @property
    def died_at(self) -> str:
        """Name of the point at which the child died; empty if it did not die at one."""
        length = int(_HEAD.unpack_from(self._memory)[2])
        return self._memory[_TEXT_AT : _TEXT_AT + length].decode()

    def _write(self, ahead: int, count: int, length: int) -> None:
        _HEAD.pack_into(self._memory, 0, ahead, count, length)
