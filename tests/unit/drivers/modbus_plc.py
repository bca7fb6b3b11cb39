"""Small PLC for tests of the Modbus driver, written only from docs/reference/modbus-register-map.md.

It has plain registers and moves along straight lines at constant speed, with the time passed to it. Numbers are
float64, high word first. `disturb(request, answer)` may return another answer, or None to lose it.
"""

from __future__ import annotations

import math
import socket
import struct
import threading
import zlib
from collections.abc import Callable

WRITABLE = [*range(2000, 2023), *range(2100, 2134), *range(2200, 2321), *range(2400, 2402)]
READABLE = [*range(1000, 1070), *range(1100, 1163), *range(1200, 1322), *WRITABLE]
TRAVEL = ((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0))
RAPID_MM_PER_S = 100.0


class FakePlc:
    def __init__(self) -> None:
        self.registers = dict.fromkeys(READABLE, 0)
        self.now_s = 0.0
        self.requests: list[bytes] = []
        self.connections = 0
        self.commands: list[int] = []
        self.disturb: Callable[[bytes, bytes], bytes | None] = lambda _request, answer: answer
        self.offers_23 = True
        self.heartbeat_runs = True
        self.handles_commands = True
        self.acknowledge_after_s = 0.0
        self.brakes_for_s = 0.0
        self.override = 1.0
        self.ends_off_mm = (0.0, 0.0, 0.0)
        self._brake_until_s = math.inf
        self.trip_at_mm: float | None = None
        self.wrong_latch: tuple[float, float, float] | None = None
        self.fault_at_s: tuple[float, int] | None = None
        self.corrupt_data: Callable[[dict[int, bytes]], None] = lambda _blocks: None
        self._handled = 0
        self._seen: tuple[int, float] | None = None
        self._beat = (0, 0.0)
        self._target: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._speed = 0.0
        self._motion: tuple[float, tuple[float, ...], tuple[float, ...], float, int] | None = None
        self._blocks: dict[int, bytes] = {}
        self.banks: dict[int, tuple[bytes, bytes]] = {}
        self._armed_until_s = 0.0
        self._prepare()
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

    def set_words(self, address: int, fmt: str, *values: float) -> None:
        data = struct.pack(">" + fmt, *values)
        for index, word in enumerate(struct.unpack(f">{len(data) // 2}H", data)):
            self.registers[address + index] = word

    def get_words(self, address: int, fmt: str) -> tuple:
        count = struct.calcsize(">" + fmt) // 2
        return struct.unpack(">" + fmt, self._bytes(address, count))

    def _bytes(self, address: int, count: int) -> bytes:
        return struct.pack(f">{count}H", *(self.registers[address + index] for index in range(count)))

    def _prepare(self) -> None:
        self.set_words(1000, "HH", 0x5643, 0x0100)
        self.set_words(1006, "HH", 0x7F, 3)
        self.set_words(1012, "3d", 100.0, 200.0, 300.0)
        self.set_words(1043, "H", 0xFFFF)
        self.set_words(1052, "H8i", 3, 20500, 21000, -125, *[-(2**31)] * 5)
        self.set_words(1100, "6d", *TRAVEL[0], *TRAVEL[1])
        self.set_words(1124, "6d", *[RAPID_MM_PER_S] * 3, *[1e12] * 3)
        self.set_words(1148, "4HIddH", 2, 60, 20, 20, 24000, 0.0001, 0.5, 0)

    # wire

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

    def drop_client(self) -> None:
        """Close the connection, as when a switch restarts; the next connection is accepted."""
        assert self._connection is not None
        self._connection.shutdown(socket.SHUT_RDWR)

    def _pdu(self, pdu: bytes) -> bytes:
        function = pdu[0]
        if function == 23 and not self.offers_23:
            return bytes([0x97, 1])
        read = write = (0, 0)
        data = b""
        if function == 3:
            read = struct.unpack(">HH", pdu[1:5])
        elif function == 16:
            write, data = struct.unpack(">HH", pdu[1:5]), pdu[6:]
        elif function == 23:
            read, write, data = struct.unpack(">HH", pdu[1:5]), struct.unpack(">HH", pdu[5:9]), pdu[10:]
        if not _inside(write, WRITABLE) or not _inside(read, READABLE):
            return bytes([function | 0x80, 2])
        for index in range(write[1]):
            self.registers[write[0] + index] = int.from_bytes(data[2 * index : 2 * index + 2], "big")
        self._cycle()
        if function == 16:
            return pdu[:5]
        return bytes([function, 2 * read[1]]) + self._bytes(*read)

    # program

    def advance_to(self, now_s: float) -> None:
        self.now_s = now_s
        self._move()

    def _cycle(self) -> None:
        if self.heartbeat_runs:
            self.registers[1002] = self.registers[1069] = (self.registers[1002] + 1) & 0xFFFF
        self.registers[1003] = self.registers[2000]
        if self.registers[2000] != self._beat[0]:
            self._beat = (self.registers[2000], self.now_s)
        self._move()
        self._take_command()
        self._brake()
        self._take_block()
        self._show_block()

    def _take_command(self) -> None:
        sequence = self.registers[2022]
        if not self.handles_commands or sequence in (0, self._handled):
            return
        if self._seen is None or self._seen[0] != sequence:
            self._seen = (sequence, self.now_s)
        if self.now_s < self._seen[1] + self.acknowledge_after_s:
            return
        self._handled = sequence
        self.commands.append(self.registers[2001])
        self.registers[1009] = self._decide(self.registers[2001], sequence)
        self.registers[1008] = sequence

    def _decide(self, code: int, sequence: int) -> int:
        state = self.registers[1004]
        if code in (11, 12, 13, 14, 15):
            return self._begin_motion(sequence) if state == 0 else 3
        if code == 21 and state == 1:
            self._halt(2, 1)
        elif code == 22 and state == 2:
            self._begin_motion(self.registers[1010])
        elif code == 23 and state in (1, 2):
            self._brake_until_s = self.now_s + self.brakes_for_s
        elif code == 24:
            self.registers[1004] = self.registers[1005] = 0
        elif code > 30:
            return self._table_command(code)
        return 1

    def _begin_motion(self, sequence: int) -> int:
        if self.registers[1006] != 0x7F:
            return 4
        target, feed = self.get_words(2006, "3d"), self.get_words(2018, "d")[0]
        if self.registers[2001] == 22:  # resumed: the former target
            target = self._target
        if not all(low <= value <= high for low, value, high in zip(TRAVEL[0], target, TRAVEL[1], strict=True)):
            return 5
        self._target = target
        speed = (feed or RAPID_MM_PER_S) * self.override
        if self.registers[2001] == 22:
            speed = self._speed
        else:
            self._code = self.registers[2001]
        self._speed = speed
        start = self.get_words(1012, "3d")
        self._motion = (self.now_s, start, target, _seconds(math.dist(start, target), speed), sequence)
        self._beat = (self._beat[0], self.now_s)
        self.registers[1004] = 1
        self.registers[1010], self.registers[1011] = sequence, 1
        return 1

    def _halt(self, state: int, outcome: int) -> None:
        self._motion = None
        self.registers[1004], self.registers[1011] = state, outcome

    def _brake(self) -> None:
        if self.now_s >= self._brake_until_s:
            self._brake_until_s = math.inf
            self._halt(0, 6)

    def _move(self) -> None:
        if self._motion is None:
            return
        began_s, start, target, duration_s, sequence = self._motion
        if self.now_s > self._beat[1] + 1.0:
            self._halt(3, 7)
            self.registers[1005] = 6
            return
        if self.fault_at_s is not None and self.now_s >= self.fault_at_s[0]:
            self._halt(3, 8)
            self.registers[1005] = self.fault_at_s[1]
            return
        share = 1.0 if duration_s == 0.0 else min(1.0, (self.now_s - began_s) / duration_s)
        length = math.dist(start, target)
        trip = False
        if self.trip_at_mm is not None and self._code >= 13 and share * length >= self.trip_at_mm:
            trip, share = True, self.trip_at_mm / length
        here = [a + share * (b - a) for a, b in zip(start, target, strict=True)]
        self.set_words(1012, "3d", *here)
        if self._code == 15 and (trip or share >= 1.0):
            latch = self.wrong_latch if self.wrong_latch is not None else here
            self.set_words(1024, "HH3d", sequence, 1 if trip else 2, *latch)
            self._halt(0, 3 if trip else 4)
        elif trip:
            self._halt(3, 5)
            self.registers[1005] = 5
        elif share >= 1.0:
            self.set_words(1012, "3d", *(a + b for a, b in zip(here, self.ends_off_mm, strict=True)))
            self._halt(0, 2)

    # tables

    def _table_command(self, code: int) -> int:
        bank, nonce = self.registers[2002], self.registers[2003]
        crc = self.get_words(2004, "I")[0]
        if code == 31:
            return self._begin_table(bank)
        if code == 32:
            return self._commit(bank, crc)
        if code == 33:
            return self._arm(bank, crc)
        if bank != self.registers[1041] or nonce != self.registers[1042] or self.now_s > self._armed_until_s:
            return 25
        self.registers[1042] = 0
        self.registers[1038] = bank
        return 1

    def _begin_table(self, bank: int) -> int:
        if bank not in (1, 2):
            return 20
        if bank == self.registers[1038]:
            return 21
        self._blocks = {}
        self.banks.pop(bank, None)
        self.registers[1040], self.registers[1045 + bank] = bank, 1
        self.registers[1044] = self.registers[1045] = self.registers[2320] = 0
        return 1

    def _arm(self, bank: int, crc: int) -> int:
        if bank and bank not in self.banks:
            return 26
        if bank and crc != self.get_words(1046 + 2 * bank, "I")[0]:
            return 24
        self.registers[1041] = bank
        self.registers[1042] = self.registers[1042] % 0xFFFF + 7
        self._armed_until_s = self.now_s + 5.0
        return 1

    def _commit(self, bank: int, crc: int) -> int:
        if bank != self.registers[1040]:
            return 27
        nodes = math.prod(self.get_words(2101, "3H"))
        data = b"".join(self._blocks[number] for number in sorted(self._blocks))[: 12 * nodes]
        if len(data) < 12 * nodes:
            return 23
        self.registers[1040] = 0
        if not zlib.crc32(data) == crc == self.get_words(2132, "I")[0]:
            self.registers[1045 + bank] = 3
            return 24
        self.corrupt_data(self._blocks)
        self.banks[bank] = (self._bytes(2100, 34), b"".join(self._blocks[n] for n in sorted(self._blocks)))
        self.registers[1045 + bank], self.registers[1039] = 2, bank
        self.set_words(1046 + 2 * bank, "I", crc)
        return 1

    def _take_block(self) -> None:
        number = self.registers[2320]
        if self.registers[1040] == 0 or number in (0, self.registers[1044]):
            return
        if number != self.registers[1044] + 1:
            self.registers[1045] = 23
            return
        self._blocks[number] = self._bytes(2200, 120)
        self.registers[1044], self.registers[1045] = number, 1

    def _show_block(self) -> None:
        bank, number = self.registers[2400], self.registers[2401]
        descriptor, data = self.banks.get(bank, (struct.pack(">34H", bank, *[0] * 33), b""))
        block = descriptor if number == 0 else data[240 * (number - 1) : 240 * number]
        if not block:
            number = 0xFFFF
        self.set_words(1200, "HH", bank, number)
        self.set_words(1202, "120H", *struct.unpack(">120H", block.ljust(240, b"\x00")))


def _seconds(length_mm: float, speed_mm_per_s: float) -> float:
    return length_mm / speed_mm_per_s if speed_mm_per_s > 0.0 else math.inf


def _inside(part: tuple[int, int], allowed: list[int]) -> bool:
    return all(address in allowed for address in range(part[0], part[0] + part[1]))
