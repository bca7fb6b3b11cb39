"""Pseudo-terminal: the far end of a serial line that a program opens like `/dev/ttyUSB0`."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import tty
from collections.abc import Callable
from pathlib import Path

import structlog

from drivers.errors import ConfigurationError

RECEIVE_BYTES = 4096
ANY = "any"
"""Value used instead of a link's path if no link is to be made; the terminal then has only the system's name."""
log = structlog.get_logger()


class PseudoTerminal:
    """One serial line. The function `received` is called with the bytes that arrive, in this object's own thread.

    Bytes sent are lost once the terminal's buffer is full, as on a line without handshake. Tests set `distort` to a
    function that alters the bytes sent, as a bad cable does. Raises ConfigurationError if a link to the terminal cannot
    be created at the path `link`.
    """

    def __init__(self, name: str, received: Callable[[bytes], None], link: str = ANY) -> None:
        self._name = name
        self._received = received
        self._link = None if link == ANY else Path(link)
        self._ours, self._theirs = pty.openpty()
        self._wake, self._waker = os.pipe()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._closed = False
        self.port = os.ttyname(self._theirs)
        self.distort: Callable[[bytes], bytes] | None = None
        try:
            self._make_link()
        except OSError as error:
            self.close()
            raise ConfigurationError(
                f"the link to the pseudo-terminal cannot be created: {error.strerror or error}",
                hint=f"give the path of a file that does not exist yet, or {ANY}",
                file=link,
            ) from error

    @property
    def device_path(self) -> str:
        """Path of the terminal, which the program on the other side opens."""
        return self.port if self._link is None else str(self._link)

    def start(self) -> None:
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Write `data`. Bytes that do not fit into the terminal's buffer are lost."""
        if self.distort is not None:
            data = self.distort(data)
        if self._closed:
            return
        with contextlib.suppress(OSError):  # no reader, or closed: like a line that is not connected
            os.write(self._ours, data)

    def offer(self, data: bytes) -> int:
        """Write as many bytes of `data` as the line accepts, and return their number. The caller can retain the other
        bytes.
        """
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0

    def pump(self) -> None:
        """Process received bytes in the caller's thread, for callers that are driven by simulated machine time."""
        with contextlib.suppress(BlockingIOError):
            if not self._closed:
                self._received(os.read(self._ours, RECEIVE_BYTES))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        os.write(self._waker, b"!")
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5.0)
        for descriptor in (self._ours, self._theirs, self._wake, self._waker):
            os.close(descriptor)
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def _make_link(self) -> None:
        if self._link is None:
            return
        if self._link.is_symlink():
            self._link.unlink()  # left by a simulator that was killed
        self._link.symlink_to(self.port)

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._ours, self._wake], [], [])
            if self._wake in ready:
                return
            try:
                data = os.read(self._ours, RECEIVE_BYTES)
            except OSError as error:
                log.info("serial line closed", line=self._name, reason=str(error))
                return
            self._received(data)
