"""Proxy of a Modbus TCP link between the driver and the simulated controller, with sockets. It delays, loses, repeats,
reorders, cuts and garbles frames.
"""

from __future__ import annotations

import contextlib
import random
import socket
import threading
from collections.abc import Callable

HEADER_BYTES = 7
"""MODBUS Messaging on TCP/IP V1.0b, 3.1.3: transaction, protocol, length (2 bytes each), unit; the length counts the
unit."""
RECEIVE_BYTES = 4096

Disturb = Callable[[bytes], list[bytes]]
"""Function that returns the data to be sent instead of one frame, in order; it may wait."""


class ModbusProxy:
    """TCP proxy in front of the server at `address`. Each direction has a function that disturbs its frames.

    `to_server` and `to_client` disturb the next frames of their direction. `refusing` is True while new connections are
    closed at once. After `stop_forwarding` both ends stay connected, but nothing passes.
    """

    def __init__(self, address: tuple[str, int]) -> None:
        self._server_address = address
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._sockets: set[socket.socket] = set()
        self._guard = threading.Lock()
        self._forwarding = list[threading.Thread]()
        self._closed = False
        self._stuck = threading.Event()
        self.refusing = False
        self.to_server: Disturb = _unchanged
        self.to_client: Disturb = _unchanged
        self._accepting = threading.Thread(target=self._accept, name="proxy", daemon=True)
        self._accepting.start()

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def cut(self) -> None:
        """Close every connection at both ends."""
        with self._guard:
            for one in self._sockets:
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def stop_forwarding(self) -> None:
        self._stuck.set()

    def repair(self) -> None:
        """Forward everything unchanged, and cut connections that are stuck."""
        self.refusing, self.to_server, self.to_client = False, _unchanged, _unchanged
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
                while (frame := _first_frame(buffer)) is not None:
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


def _first_frame(buffer: bytes) -> bytes | None:
    """Return the first complete frame of the received data, or None."""
    if len(buffer) < HEADER_BYTES:
        return None
    length = HEADER_BYTES - 1 + int.from_bytes(buffer[4:6], "big")
    return buffer[:length] if len(buffer) >= length else None


def _unchanged(frame: bytes) -> list[bytes]:
    return [frame]


def delayed(wait: Callable[[float], object], by_s: float, count: int) -> Disturb:
    """Return a function that delays the next `count` frames by `by_s` seconds; `wait` is the function that waits."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        if count >= 0:
            wait(by_s)
        return [frame]

    return disturb


def lost(count: int) -> Disturb:
    """Return a function that drops the next `count` frames."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        return [] if count >= 0 else [frame]

    return disturb


def repeated(count: int) -> Disturb:
    """Return a function that sends each of the next `count` frames twice."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        return [frame, frame] if count >= 0 else [frame]

    return disturb


def reordered(*, late_first: bool) -> Disturb:
    """Return a function that holds the next frame back until the one after it: it is sent before that one, as a late
    answer, or after it.
    """
    held: list[bytes] = []
    done = False

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal done
        if done:
            return [frame]
        if not held:
            held.append(frame)
            return []
        done = True
        return [held[0], frame] if late_first else [frame, held[0]]

    return disturb


def garbled(rng: random.Random, count: int) -> Disturb:
    """Return a function that alters the next `count` frames: a byte is changed, a byte is lost, noise comes before."""

    def disturb(frame: bytes) -> list[bytes]:
        nonlocal count
        count -= 1
        if count < 0:
            return [frame]
        at, how = rng.randrange(len(frame)), rng.randrange(3)
        if how == 0:
            return [frame[:at] + bytes([frame[at] ^ rng.randrange(1, 256)]) + frame[at + 1 :]]
        if how == 1:
            return [frame[:at] + frame[at + 1 :]]
        return [rng.randbytes(at + 1), frame]

    return disturb
