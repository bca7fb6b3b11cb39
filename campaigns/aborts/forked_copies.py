"""Forked copies of the present process.

The original process waits until a copy has run to its end, and then continues unaffected.
"""

from __future__ import annotations

import json
import os
import select
import signal
from typing import Any

CHILD_TIMEOUT_S = 60.0


class Forks:
    """Forked child processes of this process, which run one at a time. Each child returns one JSON object to the
    parent.
    """

    def __init__(self, timeout_s: float = CHILD_TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._pipe: int | None = None

    @property
    def is_child(self) -> bool:
        return self._pipe is not None

    def fork(self) -> dict[str, Any] | None:
        """Fork the process. Return None in the child.

        In the parent, wait for the child to end and return the child's result. If the child has sent no result or has
        not ended in time, return an object that gives this reason under the key ``failures``.
        """
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self._pipe = writing
            return None
        os.close(writing)
        try:
            return _read_result(reading, child, self._timeout_s)
        finally:
            os.close(reading)
            os.waitpid(child, 0)

    def send_and_exit(self, result: dict[str, Any]) -> None:
        """Send the child's result to the parent and exit, without closing or flushing any file that the parent has
        opened.
        """
        assert self._pipe is not None
        os.write(self._pipe, json.dumps(result, default=str).encode())
        os._exit(0)


def _read_result(reading: int, child: int, timeout_s: float) -> dict[str, Any]:
    parts: list[bytes] = []
    while True:
        if not select.select([reading], [], [], timeout_s)[0]:
            os.kill(child, signal.SIGKILL)
            return {"failures": [f"did not end within {timeout_s:g} s"]}
        part = os.read(reading, 65536)
        if not part:
            break
        parts.append(part)
    text = b"".join(parts)
    result: dict[str, Any] = json.loads(text) if text else {"failures": ["ended without a result"]}
    return result
