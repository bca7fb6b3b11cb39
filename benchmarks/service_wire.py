"""Proxy between agent and controller that forwards Modbus TCP and records the instants at which the agent's command
STOP passes.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import perf_counter

from drivers.modbus_cnc.codes import CommandCode
from drivers.modbus_cnc.settings import BlockAddresses

HEADER = struct.Struct(">HHHB")
WRITE_AND_READ = 23
_BODY = struct.Struct(">BHHHHB")
_COMMAND = struct.Struct(">HH")
"""Heartbeat and code, the first registers of the command block (docs/reference/modbus.md)."""


class RecordingProxy:
    """Proxy that listens on `port` and forwards all data to `target`.

    `stops` contains, for each command STOP of the agent, one instant in s on the clock `time.perf_counter`. The instant
    is taken after the command is read and before it is forwarded.
    """

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.stops: list[float] = []

    def close(self) -> None:
        self._listening.close()

    def serve(self) -> None:
        with suppress(OSError):
            while True:
                agent, _ = self._listening.accept()
                controller = socket.create_connection(self._target)
                for link in (agent, controller):
                    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._requests, args=(agent, controller), daemon=True).start()
                threading.Thread(target=_answers, args=(controller, agent), daemon=True).start()

    def _requests(self, agent: socket.socket, controller: socket.socket) -> None:
        with suppress(OSError), agent, controller, agent.makefile("rb") as stream:
            while len(header := stream.read(HEADER.size)) == HEADER.size:
                body = stream.read(HEADER.unpack(header)[2] - 1)
                if _is_stop(body):
                    self.stops.append(perf_counter())
                controller.sendall(header + body)
            controller.shutdown(
                socket.SHUT_RDWR
            )  # the other thread still reads: closing alone would leave the connection open


def _answers(controller: socket.socket, agent: socket.socket) -> None:
    with suppress(OSError):
        while data := controller.recv(65536):
            agent.sendall(data)


def _is_stop(body: bytes) -> bool:
    if len(body) < _BODY.size + _COMMAND.size or body[0] != WRITE_AND_READ:
        return False
    _, _, _, register, _, _ = _BODY.unpack_from(body)
    return bool(register == BlockAddresses().command and _COMMAND.unpack_from(body, _BODY.size)[1] == CommandCode.STOP)


@contextmanager
def recording_proxy(host: str, port: int) -> Iterator[RecordingProxy]:
    between = RecordingProxy((host, port))
    threading.Thread(target=between.serve, daemon=True).start()
    try:
        yield between
    finally:
        between.close()
