"""Small PLC for tests of the Modbus driver: the registers of `modbus_registers` in virtual time, behind a TCP socket.

`disturb(request, answer)` may return another answer, or None to lose it.
"""

from __future__ import annotations

import math
import socket
import struct
import threading
from collections.abc import Callable

from modbus_registers import ControllerRegisters, Point, inside_a_block


class FakePlc(ControllerRegisters):
    upper = (4000.0, 1300.0, 1500.0)
    rapid_mm_per_s = 100.0
    acceleration_mm_per_s2 = 1e12
    start = (100.0, 200.0, 300.0)
    temperatures = (20500, 21000, -125)
    most_nodes = (60, 20, 20, 24000)

    def __init__(self) -> None:
        super().__init__(lambda: self.now_s)
        self.now_s = 0.0
        self.requests: list[bytes] = []
        self.connections = 0
        self.disturb: Callable[[bytes, bytes], bytes | None] = lambda _request, answer: answer
        self.offers_23 = True
        self.trip_at_mm: float | None = None
        self.fault_at_s: tuple[float, int] | None = None
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._connection: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.hang_up()
        self._thread.join(5.0)

    def hang_up(self) -> None:
        """Close the connection and the listener, as when the process is killed."""
        for end in (self._connection, self._listener):
            if end is not None:
                try:
                    end.shutdown(socket.SHUT_RDWR)
                except OSError:
                    continue
                finally:
                    end.close()

    def drop_client(self) -> None:
        """Close the connection, as when a switch restarts; the next connection is accepted."""
        assert self._connection is not None
        self._connection.shutdown(socket.SHUT_RDWR)

    def advance_to(self, now_s: float) -> None:
        self.now_s = now_s
        self._move()

    def trip_distance_mm(self, start: Point, end: Point) -> float:
        return math.inf if self.trip_at_mm is None else self.trip_at_mm

    def _move(self) -> None:
        if self.motion is not None and self.fault_at_s is not None and self.now_s >= self.fault_at_s[0]:
            self._halt(3, 8, self.fault_at_s[1])
        super()._move()

    def _serve(self) -> None:
        while True:
            try:
                self._connection, _ = self._listener.accept()
                self.connections += 1
                with self._connection:
                    self._serve_client(self._connection)
            except OSError:
                if self._listener.fileno() < 0:
                    return

    def _serve_client(self, client: socket.socket) -> None:
        while request := client.recv(1024):
            self.requests.append(request)
            body = self._pdu(request[7:])
            frame = request[:4] + struct.pack(">HB", len(body) + 1, request[6]) + body
            answer = self.disturb(request, frame)
            if answer is not None:
                client.sendall(answer)

    def _pdu(self, pdu: bytes) -> bytes:
        function = pdu[0]
        if function == 23 and not self.offers_23:
            return bytes([0x97, 1])
        read = write = None
        if function == 3:
            read = struct.unpack(">HH", pdu[1:5])
        elif function == 16:
            write, data = struct.unpack(">HH", pdu[1:5]), pdu[6:]
        elif function == 23:
            read, write, data = struct.unpack(">HH", pdu[1:5]), struct.unpack(">HH", pdu[5:9]), pdu[10:]
        if (write and not inside_a_block(*write, write=True)) or (read and not inside_a_block(*read, write=False)):
            return bytes([function | 0x80, 2])
        if write:
            self.write(write[0], [word for (word,) in struct.iter_unpack(">H", data)])
        self.cycle()
        if read is None:
            return pdu[:5]
        return bytes([function, 2 * read[1]]) + struct.pack(f">{read[1]}H", *self.registers[read[0] :][: read[1]])
