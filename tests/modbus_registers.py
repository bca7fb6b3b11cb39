"""Controller with the documented register map, written only from docs/reference/modbus-register-map.md.

It moves along straight lines at constant speed and stores tables; the wire, the clock and the obstacles are those of
the fakes that use it. It executes what a request writes before it reads the answer.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable
from typing import Any

BLOCKS = {1000: (70, False), 1100: (63, False), 1200: (122, False), 2000: (23, True), 2100: (34, True),
          2200: (121, True), 2400: (2, True)}  # fmt: skip
Point = tuple[float, ...]


def inside_a_block(address: int, count: int, *, write: bool) -> bool:
    """Return True if one block of the map has all these registers and, with `write`, may be written."""
    return any(
        first <= address and address + count <= first + size
        for first, (size, writable) in BLOCKS.items()
        if writable or not write
    )


class ControllerRegisters:
    """Registers of the controller, and the program behind them that `cycle` runs once.

    `scale`: None for float64, otherwise mm of a count of int32. `low_word` and `low_byte`: order on the wire.
    """

    lower: Point = (0.0, 0.0, 0.0)
    upper: Point = (500.0, 500.0, 500.0)
    rapid_mm_per_s = 500.0
    acceleration_mm_per_s2 = 20000.0
    start: Point = (100.0, 100.0, 100.0)
    temperatures: tuple[int, ...] = (20125,)
    most_nodes = (20, 20, 20, 400)
    resolution_mm = 1e-4
    most_mm = 0.5
    overtravel_mm = 0.0
    override = 1.0
    brakes_for_s = 0.0
    acknowledge_after_s = 0.0
    handles_commands = True
    heartbeat_runs = True
    ends_off_mm: Point = (0.0, 0.0, 0.0)
    wrong_latch: Point | None = None

    def __init__(
        self, now_s: Callable[[], float], scale: float | None = None, *, low_word: bool = False, low_byte: bool = False
    ) -> None:
        self.clock_s = now_s
        self.scale, self.low_word, self.low_byte = scale, low_word, low_byte
        self.registers = [0] * 2402
        self.commands: list[int] = []
        self.handled = self.nonce = 0
        self.armed_until_s = self.heard_s = 0.0
        self.motion: dict[str, Any] | None = None
        self.stored: dict[int, tuple[list[int], list[int]]] = {}
        self.coming: list[int] = []
        self.crcs: dict[int, int] = {}
        self.corrupt_data: Callable[[list[int]], None] = lambda _counts: None
        self._held: dict[str, Any] | None = None
        self._seen = (0, 0.0)
        self._heartbeat = 0
        self._brake_until_s = math.inf
        self._prepare()

    # values

    def _ordered(self, words: list[int]) -> list[int]:
        words = words[::-1] if self.low_word else words
        return [(word >> 8 | word << 8) & 0xFFFF for word in words] if self.low_byte else words

    def put(self, address: int, fmt: str, value: float) -> None:
        words = self._ordered([word for (word,) in struct.iter_unpack(">H", struct.pack(">" + fmt, value))])
        self.registers[address : address + len(words)] = words

    def get(self, address: int, fmt: str) -> float:
        count = struct.calcsize(">" + fmt) // 2
        words = self._ordered(self.registers[address : address + count])
        return struct.unpack(">" + fmt, struct.pack(f">{count}H", *words))[0]

    def put_numbers(self, address: int, *values: float) -> None:
        for place, value in zip(range(address, 2402, 4), values, strict=False):
            if self.scale is None:
                self.put(place, "d", value)
            else:
                self.put(place, "i", round(value / self.scale))
                self.registers[place + 2 : place + 4] = [0, 0]

    def number(self, address: int) -> float:
        return self.get(address, "d") if self.scale is None else self.get(address, "i") * self.scale

    def triple(self, address: int) -> Point:
        return tuple(self.number(address + 4 * index) for index in range(3))

    def _prepare(self) -> None:
        self.registers[1000:1002] = [0x5643, 0x0100]
        self.registers[1006:1008] = [0x7F, 3]
        self.here = self.start
        self.put_numbers(1012, *self.start)
        self.put_numbers(1026, *self.start)
        self.registers[1043] = 0xFFFF
        self.registers[1052] = len(self.temperatures)
        for place in range(8):
            known = place < len(self.temperatures)
            self.put(1053 + 2 * place, "i", self.temperatures[place] if known else -(2**31))
        self.put_numbers(1100, *self.lower, *self.upper)
        self.put_numbers(1124, *(self.rapid_mm_per_s,) * 3, *(self.acceleration_mm_per_s2,) * 3)
        self.registers[1148:1152] = [2, *self.most_nodes[:3]]
        self.put(1152, "I", self.most_nodes[3])
        self.put_numbers(1154, self.resolution_mm, self.most_mm)

    # program

    def write(self, address: int, words: list[int]) -> None:
        """Store what a request writes; a heartbeat that has changed keeps the watchdog from stopping the axes."""
        if address == 2000 and words[0] != self.registers[2000]:
            self.heard_s = self.clock_s()
        self.registers[address : address + len(words)] = words

    def cycle(self) -> None:
        words = self.registers
        if self.clock_s() > self.armed_until_s:
            words[1042] = 0
        self._move()
        self._take_command()
        if self.clock_s() >= self._brake_until_s:
            self._halt(0, 6)
        self._take_block()
        self._show_block()
        if self.heartbeat_runs:
            self._heartbeat = self._heartbeat % 0xFFFF + 1
            words[1002] = words[1069] = self._heartbeat
        words[1003] = words[2000]

    def _take_command(self) -> None:
        sequence, now_s = self.registers[2022], self.clock_s()
        if not self.handles_commands or sequence in (0, self.handled):
            return
        if self._seen[0] != sequence:
            self._seen = (sequence, now_s)
        if now_s < self._seen[1] + self.acknowledge_after_s:
            return
        self.handled = sequence
        self.commands.append(self.registers[2001])
        self.registers[1009] = self._decide(self.registers[2001])
        self.registers[1008] = sequence

    def _decide(self, code: int) -> int:
        state = self.registers[1004]
        if 11 <= code <= 15:
            return self._start(code)
        if 31 <= code <= 34:
            return self._table(code) if state == 0 else 3
        allowed = {21: state != 3, 22: state != 3, 23: True, 24: state not in (1, 2)}
        if not allowed.get(code, False):
            return 3 if code in allowed else 2
        if code == 21 and state == 1:
            held = self.motion
            self._halt(2, 1)
            self._held = held
        elif code == 22 and state == 2 and self._held is not None:
            self._begin({**self._held, "from": self.here})
        elif code == 23 and state in (1, 2):
            self._brake_until_s = self.clock_s() + self.brakes_for_s
        elif code == 24:
            self.registers[1004] = self.registers[1005] = 0
        return 1

    def _start(self, code: int) -> int:
        target, feed = self.triple(2006), self.number(2018)
        feed = self.rapid_mm_per_s if code in (11, 13) else feed
        travels = zip(self.lower, target, self.upper, strict=True)
        reasons = {
            3: self.registers[1004] != 0,
            4: self.registers[1006] != 0x7F,
            7: not all(math.isfinite(value) for value in (*target, feed)),
            5: not all(low <= value <= high for low, value, high in travels),
            6: not 0.0 < feed <= self.rapid_mm_per_s,
            10: code == 15 and self.registers[1007] & 4,
        }
        for result, holds in reasons.items():
            if holds:
                return result
        self._begin(
            {"code": code, "number": self.handled, "from": self.here, "to": target, "speed": feed * self.override}
        )
        return 1

    def _begin(self, motion: dict[str, Any]) -> None:
        self.heard_s = self.clock_s()
        self.motion = {**motion, "since_s": self.heard_s}
        self.registers[1004] = 1
        self.registers[1010:1012] = [motion["number"], 1]

    def trip_distance_mm(self, start: Point, end: Point) -> float:
        """Return the distance from `start` at which the probe trips on the way to `end`; inf if it does not."""
        return math.inf

    def _move(self) -> None:
        motion = self.motion
        if motion is None:
            return
        start, target, touching = motion["from"], motion["to"], motion["code"] == 15
        length = math.dist(start, target)
        done = motion["speed"] * (self.clock_s() - motion["since_s"])
        trip = self.trip_distance_mm(start, target) if motion["code"] >= 13 and length else math.inf
        if self.clock_s() - self.heard_s > 1.0:
            self._halt(3, 7, 6)
        elif trip <= min(done, length):
            self._stand_at(along(start, target, min(trip + self.overtravel_mm, length) / length))
            self._latch(motion, 1, along(start, target, trip / length))
            self._halt(0, 3) if touching else self._halt(3, 5, 5)
        elif done >= length:
            self._stand_at(tuple(a + b for a, b in zip(target, self.ends_off_mm, strict=True)))
            self._latch(motion, 2, target)
            self._halt(0, 4 if touching else 2)
        else:
            self._stand_at(along(start, target, done / length))

    def _stand_at(self, here: Point) -> None:
        self.here = here
        self.put_numbers(1012, *here)

    def _latch(self, motion: dict[str, Any], result: int, position: Point) -> None:
        if motion["code"] == 15:
            self.put_numbers(1026, *(self.wrong_latch or position))
            self.registers[1024:1026] = [motion["number"], result]

    def _halt(self, state: int, outcome: int, fault: int = 0) -> None:
        self.motion = self._held = None
        self._brake_until_s = math.inf
        self.registers[1004:1006] = [state, fault]
        self.registers[1011] = outcome

    # tables

    def _table(self, code: int) -> int:
        words, bank = self.registers, self.registers[2002]
        crc = int(self.get(2004, "I"))
        result = {31: self._begin_table, 32: self._commit, 33: self._arm, 34: self._activate}[code](bank, crc)
        if result == 1 and code != 33:
            words[1042] = 0
        return result

    def _begin_table(self, bank: int, _crc: int) -> int:
        words = self.registers
        if bank not in (1, 2):
            return 20
        if bank == words[1038]:
            return 21
        if words[2100] != bank or not 1 <= math.prod(words[2101:2104]) <= self.most_nodes[3]:
            return 22
        if not math.isclose(self.number(2128), self.resolution_mm, rel_tol=1e-12):
            return 22
        self.coming = []
        self.stored.pop(bank, None)
        self.stored[0] = (words[2100:2134], [])
        words[1039] = 0 if words[1039] == bank else words[1039]
        words[1040], words[1045 + bank] = bank, 1
        self.put(1046 + 2 * bank, "I", 0)
        words[1044] = words[1045] = words[2320] = 0
        return 1

    def _take_block(self) -> None:
        words = self.registers
        number = words[2320]
        if number in (0, words[1044]):
            return
        if words[1040] == 0:
            words[1045] = 27
        elif number != words[1044] + 1:
            words[1045] = 23
        else:
            counts = [int(self.get(2200 + 2 * index, "i")) for index in range(60)]
            if max(map(abs, counts)) * self.resolution_mm > self.most_mm:
                words[1045] = 7
                return
            self.coming += counts
            words[1044:1046] = [number, 1]

    def _commit(self, bank: int, crc: int) -> int:
        words = self.registers
        descriptor, _ = self.stored.get(0, ([], []))
        if words[1040] == 0 or bank != words[1040]:
            return 27
        counts = self.coming[: 3 * math.prod(descriptor[1:4])]
        if len(counts) < 3 * math.prod(descriptor[1:4]):
            return 23
        words[1040] = 0
        if not zlib.crc32(struct.pack(f">{len(counts)}i", *counts)) == crc == self.get(2132, "I"):
            words[1045 + bank] = 3
            return 24
        self.corrupt_data(counts)
        self.stored[bank] = (descriptor, counts)
        self.crcs[bank] = crc
        words[1045 + bank], words[1039] = 2, bank
        self.put(1046 + 2 * bank, "I", crc)
        return 1

    def _arm(self, bank: int, crc: int) -> int:
        if bank not in (0, 1, 2):
            return 20
        if bank and bank not in self.crcs:
            return 26
        if bank and crc != self.crcs[bank]:
            return 24
        self.nonce += 1
        self.armed_until_s = self.clock_s() + 5.0
        self.registers[1041:1043] = [bank, self.nonce]
        return 1

    def _activate(self, bank: int, _crc: int) -> int:
        words = self.registers
        if words[1042] == 0 or [bank, words[2003]] != words[1041:1043]:
            return 25
        words[1038] = bank
        words[1039] = 0 if words[1039] == bank else words[1039]
        return 1

    def _show_block(self) -> None:
        bank, block = self.registers[2400:2402]
        descriptor, counts = self.stored.get(bank, ([bank, *[0] * 33], [])) if bank in (1, 2) else ([], [])
        self.registers[1202:1322] = [0] * 120
        part = counts[60 * (block - 1) : 60 * block] if block else []
        if bank not in (1, 2) or (block and not part):
            block = 0xFFFF
        elif block == 0:
            self.registers[1202:1236] = descriptor
        for index, count in enumerate(part):
            self.put(1202 + 2 * index, "i", count)
        self.registers[1200:1202] = [bank, block]


def along(start: Point, end: Point, share: float) -> Point:
    return tuple(a + share * (b - a) for a, b in zip(start, end, strict=True))
