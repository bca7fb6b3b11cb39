"""Far end of a serial line in tests: a pseudo-terminal and the device that answers on it."""

from __future__ import annotations

import os
import pty
import select
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory


def crc(data: bytes) -> bytes:
    """Return the CRC-16, computed step by step as in MODBUS over Serial Line V1.02, 6.2.2."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register, carried = register >> 1, register & 1
            if carried:
                register ^= 0b1010_0000_0000_0001
    return bytes((register & 0xFF, register >> 8))


def framed(hexed: str) -> bytes:
    data = bytes.fromhex(hexed)
    return data + crc(data)


def request_length(data: bytes) -> int | None:
    """Return the length in bytes of the request that begins with `data`, or None if it is not yet known."""
    if len(data) < 2:
        return None
    at = {16: 6, 23: 10}.get(data[1])
    if at is None:
        return 8
    return at + 3 + data[at] if len(data) > at else None


class RtuSlave:
    """Slave that calls `answer(request)` for each whole request, CRC included, and sends the
    result; None: no answer.
    """

    def __init__(self, answer: Callable[[bytes], bytes | None]) -> None:
        self._answer = answer
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        self._wake, self._waker = os.pipe()
        # under a name of its own, since the system's name may become another test's once this line is closed
        self._folder = TemporaryDirectory()
        self.port = f"{self._folder.name}/tty"
        Path(self.port).symlink_to(os.ttyname(self._theirs))
        self.requests: list[bytes] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def push(self, data: bytes) -> None:
        """Send unsolicited bytes."""
        os.write(self._ours, data)

    def close(self) -> None:
        """Close the line as an unplugged adapter does."""
        if self._ours < 0:
            return
        os.write(self._waker, b"!")
        self._thread.join(5.0)
        for end in (self._ours, self._theirs, self._wake, self._waker):
            os.close(end)
        self._folder.cleanup()
        self._ours = -1

    def _serve(self) -> None:
        buffer = b""
        while True:
            ready, _, _ = select.select([self._ours, self._wake], [], [])
            if self._wake in ready:
                return
            buffer += os.read(self._ours, 1024)
            while (length := request_length(buffer)) is not None and len(buffer) >= length:
                request, buffer = buffer[:length], buffer[length:]
                self.requests.append(request)
                answer = self._answer(request)
                if answer:
                    os.write(self._ours, answer)


def scripted(*answers: bytes | None) -> RtuSlave:
    """Return a function that answers request n with `answers[n]`, and nothing afterwards."""
    left = list(answers)
    return RtuSlave(lambda _request: left.pop(0) if left else None)
