"""Proxies of a link between a driver and a simulated device. They disturb frames and cut the link: over TCP with
sockets, and over a serial line with pseudo-terminals.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import termios
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from campaigns.faults.disturbances import Disturb, unchanged

MODBUS_HEADER_BYTES = 7
"""MODBUS Messaging on TCP/IP V1.0b, 3.1.3: transaction, protocol, length (2 bytes each), unit; the length counts the
unit."""
RECEIVE_BYTES = 4096
QUIET_S = 0.005
"""Silence in s of the wall clock that ends a frame without an end of its own."""

Framing = Callable[[bytes], bytes | None]
"""Function that returns the first complete frame of the received data, or None."""


def modbus_frame(buffer: bytes) -> bytes | None:
    """Return the first frame of Modbus TCP, or None."""
    if len(buffer) < MODBUS_HEADER_BYTES:
        return None
    length = MODBUS_HEADER_BYTES - 1 + int.from_bytes(buffer[4:6], "big")
    return buffer[:length] if len(buffer) >= length else None


def ending_with(end: bytes) -> Framing:
    """Return a function that returns the first frame that ends with `end`."""

    def first(buffer: bytes) -> bytes | None:
        length = buffer.find(end) + len(end)
        return buffer[:length] if length >= len(end) else None

    return first


def until_quiet(_: bytes) -> None:
    """Return None: the frame ends with a silence."""


class LinkProxy(Protocol):
    """Proxy of a link. `to_server` and `to_client` disturb the next frames of their direction. While `refusing` is
    True, the driver cannot connect.
    """

    refusing: bool
    to_server: Disturb
    to_client: Disturb

    def cut(self) -> None:
        """Cut the connection at both ends."""

    def stop_forwarding(self) -> None:
        """Let nothing pass any more, with both ends connected."""

    def repair(self) -> None:
        """Forward everything unchanged, and cut connections that are stuck."""

    def close(self) -> None: ...


class TcpProxy:
    """TCP proxy in front of the server at `address`; `framing` finds its frames."""

    def __init__(self, address: tuple[str, int], framing: Framing) -> None:
        self._server_address = address
        self._framing = framing
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._sockets: set[socket.socket] = set()
        self._guard = threading.Lock()
        self._forwarding = list[threading.Thread]()
        self._closed = False
        self._stuck = threading.Event()
        self.refusing = False
        self.to_server: Disturb = unchanged
        self.to_client: Disturb = unchanged
        self._accepting = threading.Thread(target=self._accept, name="proxy", daemon=True)
        self._accepting.start()

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def cut(self) -> None:
        with self._guard:
            for one in self._sockets:
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def stop_forwarding(self) -> None:
        self._stuck.set()

    def repair(self) -> None:
        self.refusing, self.to_server, self.to_client = False, unchanged, unchanged
        if self._stuck.is_set():
            self._stuck.clear()
            self.cut()

    def close(self) -> None:
        self._closed = True
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut()
        self._accepting.join()
        for forwarding in self._forwarding:
            forwarding.join()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            if self.refusing:
                client.close()
                continue
            try:
                server = socket.create_connection(self._server_address)
            except OSError:
                client.close()
                continue
            with self._guard:
                self._sockets |= {client, server}
            for source, target, upwards in ((client, server, True), (server, client, False)):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                forwarding = threading.Thread(target=self._forward, args=(source, target, upwards), daemon=True)
                self._forwarding.append(forwarding)
                forwarding.start()
            if self._closed:
                self.cut()

    def _forward(self, source: socket.socket, target: socket.socket, upwards: bool) -> None:
        buffer = b""
        with contextlib.suppress(OSError):
            while chunk := source.recv(RECEIVE_BYTES):
                buffer += chunk
                while (frame := self._framing(buffer)) is not None:
                    buffer = buffer[len(frame) :]
                    disturb = self.to_server if upwards else self.to_client
                    for data in disturb(frame):
                        if not self._stuck.is_set():
                            target.sendall(data)
        for one in (source, target):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        with self._guard:
            self._sockets.discard(source)
        source.close()


class SerialProxy:
    """Serial line between a driver, which opens the path `link`, and a device at `device`, with two pseudo-terminals.

    `framing` finds the frames. Cut is the adapter unplugged; it is plugged in again at once unless `refusing` is True.
    """

    def __init__(self, device: str, link: Path, framing: Framing, baud: int) -> None:
        self.link = link
        self._framing = framing
        self._device = os.open(device, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._device)
        attributes = termios.tcgetattr(self._device)
        attributes[4] = attributes[5] = getattr(termios, f"B{baud}")
        termios.tcsetattr(self._device, termios.TCSANOW, attributes)
        self._wake, self._waker = os.pipe()
        self._guard = threading.Lock()
        self._stuck = False
        self.refusing = False
        self.to_server: Disturb = unchanged
        self.to_client: Disturb = unchanged
        self._ours = self._theirs = -1
        self._plug_in()
        self._threads = [
            threading.Thread(target=self._forward, args=(upwards,), name="serial proxy", daemon=True)
            for upwards in (True, False)
        ]
        for thread in self._threads:
            thread.start()

    def cut(self) -> None:
        with self._guard:
            self._unplug()
            if not self.refusing:
                self._plug_in()

    def stop_forwarding(self) -> None:
        self._stuck = True

    def repair(self) -> None:
        self.refusing, self.to_server, self.to_client, self._stuck = False, unchanged, unchanged, False
        with self._guard:
            if self._ours < 0:
                self._plug_in()

    def close(self) -> None:
        os.write(self._waker, b"!")
        for thread in self._threads:
            thread.join()
        with self._guard:
            self._unplug()
        for descriptor in (self._device, self._wake, self._waker):
            os.close(descriptor)

    def _plug_in(self) -> None:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.link.symlink_to(os.ttyname(self._theirs))

    def _unplug(self) -> None:
        if self._ours < 0:
            return
        self.link.unlink()
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = self._theirs = -1

    def _forward(self, upwards: bool) -> None:
        buffer = b""
        while True:
            source = self._ours if upwards else self._device
            try:
                # A line that is plugged in again has another descriptor, so no wait is longer than a frame's silence.
                readable, _, _ = select.select([self._wake, *([source] if source >= 0 else [])], [], [], QUIET_S)
            except (OSError, ValueError):  # unplugged meanwhile
                continue
            if self._wake in readable:
                return
            data = self._read(source) if source in readable else b""
            buffer += data
            disturb = self.to_server if upwards else self.to_client
            if disturb is unchanged or (not data and self._framing is until_quiet):
                frame: bytes | None = buffer
            else:
                frame = self._framing(buffer)
            while frame:
                buffer = buffer[len(frame) :]
                for part in disturb(frame):
                    self._write(part, upwards=upwards)
                frame = self._framing(buffer)

    def _read(self, source: int) -> bytes:
        with self._guard:
            if source not in (self._ours, self._device):
                return b""
            try:
                return os.read(source, RECEIVE_BYTES)
            except OSError:  # nobody has the line open, or it was unplugged
                return b""

    def _write(self, data: bytes, *, upwards: bool) -> None:
        with self._guard:
            target = self._device if upwards else self._ours
            if target >= 0 and not self._stuck:
                with contextlib.suppress(OSError):  # a full buffer loses data, as a line without handshake does
                    os.write(target, data)
