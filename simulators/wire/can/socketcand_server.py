"""CAN bus over TCP using the socketcand protocol, for two processes without kernel CAN.

The server is itself a python-can bus. Its `recv` accepts clients, answers their commands, and passes their frames on to
the other clients and to the caller of `recv`. Its `send` goes to every client. The server has no thread, so clients are
served only during a call of `recv`.

Protocol: doc/protocol.md of linux-can/socketcand (``< hi >``, open, rawmode, send, sendrtr, echo). That document shows
the data bytes of a ``< frame ... >`` separated by blanks. The socketcand daemon writes the bytes without blanks, and
python-can's client expects no blanks. This server therefore writes no blanks either.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from collections import deque
from dataclasses import dataclass

import can
import structlog

from drivers.clock import RealClock, wall_seconds

SEND_WITHIN_S = 2.0
"""Time in s after which a client that accepts no bytes is disconnected."""
LONGEST_COMMAND = 200
ACCEPT_RETRY_S = 0.05

_log = structlog.get_logger("socketcand")


@dataclass
class _Client:
    stream: socket.socket
    pending: str = ""
    raw: bool = False


class SocketcandServerBus(can.BusABC):
    """CAN bus with the name `channel`, served at the TCP address `host`:`port`.

    If the argument `port` is 0, a free port is chosen. The attribute `port` holds the number of the port in use.
    """

    def __init__(self, channel: str, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(channel=channel)
        self.channel = channel
        self._listener = socket.create_server((host, port))
        self.host, self.port = self._listener.getsockname()[:2]
        self.channel_info = f"socketcand server {channel}@{self.host}:{self.port}"
        self._clients: dict[socket.socket, _Client] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._accept_failed = False
        self._received: deque[can.Message] = deque()
        self._lock = threading.RLock()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to every client in raw mode, and disconnect clients to which it cannot be sent."""
        del timeout
        self._broadcast(msg, sender=None)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        ends_s = None if timeout is None else wall_seconds() + timeout
        while not self._received:
            left_s = None if ends_s is None else ends_s - wall_seconds()
            if left_s is not None and left_s <= 0.0:
                self._pump(0.0)
                break
            self._pump(left_s)
        return (self._received.popleft() if self._received else None), False

    def shutdown(self) -> None:
        if self._is_shutdown:
            return
        super().shutdown()
        with self._lock:
            for client in list(self._clients.values()):
                self._drop(client, "server closed")
            self._selector.close()
            self._listener.close()

    def _pump(self, timeout: float | None) -> None:
        for key, _ in self._selector.select(timeout):
            if key.fileobj is self._listener:
                self._accept()
            else:
                client = self._clients.get(key.data)
                if client is not None:
                    self._read(client)

    def _accept(self) -> None:
        try:
            stream, _ = self._listener.accept()
        except OSError as error:
            self._report_failed_accept(error)
            return
        self._accept_failed = False
        stream.settimeout(SEND_WITHIN_S)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(stream)
        with self._lock:
            self._clients[stream] = client
            self._selector.register(stream, selectors.EVENT_READ, data=stream)
        self._write(client, "< hi >")

    def _report_failed_accept(self, error: OSError) -> None:
        """Log the first of several failures, such as a shortage of file handles. The client stays in the queue of the
        listener, so the next pump tries again after a pause."""
        if not self._accept_failed:
            _log.error("no connection can be accepted", bus=self.channel_info, reason=str(error))
        self._accept_failed = True
        RealClock().sleep(ACCEPT_RETRY_S)

    def _read(self, client: _Client) -> None:
        try:
            text = client.stream.recv(4096).decode("ascii")
        except (OSError, UnicodeDecodeError) as error:
            self._drop(client, str(error))
            return
        if not text:
            self._drop(client, "client left")
            return
        client.pending += text
        while (end := client.pending.find(">")) >= 0:
            command, client.pending = client.pending[:end], client.pending[end + 1 :]
            self._obey(client, command.strip().removeprefix("<").split())
        if len(client.pending) > LONGEST_COMMAND:
            self._drop(client, "command without an end")

    def _obey(self, client: _Client, words: list[str]) -> None:
        match words:
            case ["open", channel] if channel == self.channel:
                self._write(client, "< ok >")
            case ["open", _]:
                self._write(client, "< error could not open bus >")
                self._drop(client, "unknown bus requested")
            case ["rawmode"]:
                client.raw = True
                self._write(client, "< ok >")
            case ["echo"]:
                self._write(client, "< echo >")
            case ["send" | "sendrtr" as verb, identifier, length, *data]:
                self._take_frame(client, verb == "sendrtr", identifier, length, data)
            case _:
                self._write(client, "< error unknown command >")

    def _take_frame(self, client: _Client, remote: bool, identifier: str, length: str, data: list[str]) -> None:
        try:
            message = parse_send(identifier, length, data, remote=remote)
        except ValueError:
            self._write(client, "< error wrong frame >")
            return
        self._received.append(message)
        self._broadcast(message, sender=client)

    def _broadcast(self, message: can.Message, sender: _Client | None) -> None:
        text = format_frame(message, wall_seconds())
        with self._lock:
            for client in list(self._clients.values()):
                if client.raw and client is not sender:
                    self._write(client, text)

    def _write(self, client: _Client, text: str) -> None:
        with self._lock:
            try:
                client.stream.sendall(text.encode("ascii"))
            except OSError as error:
                self._drop(client, str(error))

    def _drop(self, client: _Client, reason: str) -> None:
        with self._lock:
            if self._clients.pop(client.stream, None) is None:
                return
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(client.stream)
            client.stream.close()
        _log.info("client disconnected", bus=self.channel_info, reason=reason)


def format_frame(message: can.Message, instant_s: float) -> str:
    """Return the text sent to a client in raw mode for a frame on the bus."""
    identifier = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    if message.is_error_frame:
        return f"< error {message.arbitration_id:08X} {instant_s:.6f} >"
    if message.is_remote_frame:
        return f"< rtr {identifier} {instant_s:.6f} {message.dlc} >"
    return f"< frame {identifier} {instant_s:.6f} {bytes(message.data).hex().upper()} >"


def parse_send(identifier: str, length: str, data: list[str], *, remote: bool) -> can.Message:
    """Return the frame that the words of a send command describe.

    An identifier with eight hexadecimal digits is an extended identifier. Raises ValueError if the words do not form a
    frame.
    """
    count = int(length)
    if not remote and count != len(data):
        raise ValueError(f"{len(data)} data bytes, announced {count}")
    return can.Message(
        arbitration_id=int(identifier, 16),
        is_extended_id=len(identifier) > 3,
        is_remote_frame=remote,
        dlc=count,
        data=None if remote else bytes(int(byte, 16) for byte in data),
        check=True,
    )
