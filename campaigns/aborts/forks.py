"""A process is copied with everything in it: the copy lives on to its end, the original goes on as if nothing were."""

from __future__ import annotations

import json
import os
import select
import signal
from typing import Any

PATIENCE_S = 60.0


class Forks:
    """Children one at a time; each leaves one JSON object."""

    def __init__(self) -> None:
        self._leaves: int | None = None

    @property
    def is_child(self) -> bool:
        return self._leaves is not None

    def split(self) -> dict[str, Any] | None:
        """None in the child, which goes on; in the parent what the child has left, or why it left nothing."""
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self._leaves = writing
            return None
        os.close(writing)
        try:
            return _left_by(reading, child)
        finally:
            os.close(reading)
            os.waitpid(child, 0)

    def leave(self, result: dict[str, Any]) -> None:
        """The child's last act; nothing that the parent has opened is closed or flushed."""
        assert self._leaves is not None
        os.write(self._leaves, json.dumps(result, default=str).encode())
        os._exit(0)


def _left_by(reading: int, child: int) -> dict[str, Any]:
    parts: list[bytes] = []
    while True:
        if not select.select([reading], [], [], PATIENCE_S)[0]:
            os.kill(child, signal.SIGKILL)
            return {"failures": [f"did not end within {PATIENCE_S:g} s"]}
        part = os.read(reading, 65536)
        if not part:
            break
        parts.append(part)
    text = b"".join(parts)
    result: dict[str, Any] = json.loads(text) if text else {"failures": ["ended without a word"]}
    return result
