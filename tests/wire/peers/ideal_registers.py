"""Ideal machine with one ball behind pyModbusTCP, written only from docs/reference/modbus-register-map.md.

Unlike the peer in C it executes what a request writes before it reads the answer, it can count in integers of a scale,
and it stores its registers by the names in the page's tables rather than by address.
"""

from __future__ import annotations

import math
import struct
import threading
import time
import zlib

from pyModbusTCP.server import DataBank, DataHandler, ModbusServer

BLOCKS = {1000: (70, False), 1100: (63, False), 1200: (122, False), 2000: (23, True), 2100: (34, True),
          2200: (121, True), 2400: (2, True)}  # fmt: skip
BALL, REACH, OVERTRAVEL = (250.0, 250.0, 100.0), 15.5, 0.05
TRAVEL, RAPID, RESOLUTION, MOST_MM = 500.0, 500.0, 1e-4, 0.5


class IdealRegisters(DataBank):
    """Registers of the ideal machine. `scale`: None for f64, else int32 counts in mm; `low_word`, `low_byte`: order on
    the wire.
    """

    def __init__(self, scale: float | None = None, *, low_word: bool = False, low_byte: bool = False) -> None:
        super().__init__(h_regs_size=2402, coils_size=1, d_inputs_size=1, i_regs_size=1)
        self.scale, self.low_word, self.low_byte = scale, low_word, low_byte
        self.words = [0] * 2402
        self.guard = threading.RLock()
        self.handled = self.beat = self.nonce = 0
        self.armed_until = self.heard = 0.0
        self.motion: dict | None = None
        self.stored: dict[int, tuple[list[int], list[int]]] = {}
        self.coming: list[int] = []
        self.crcs: dict[int, int] = {}
        self.answer_after_s = 0.0
        self._prepare()

    # values

    def _ordered(self, words: list[int]) -> list[int]:
        words = words[::-1] if self.low_word else words
        return [(word >> 8 | word << 8) & 0xFFFF for word in words] if self.low_byte else words

    def put(self, address: int, fmt: str, value: float) -> None:
        data = struct.pack(">" + fmt, value)
        words = self._ordered([word for (word,) in struct.iter_unpack(">H", data)])
        self.words[address : address + len(words)] = words

    def get(self, address: int, fmt: str) -> float:
        count = struct.calcsize(">" + fmt) // 2
        return struct.unpack(
            ">" + fmt, struct.pack(f">{count}H", *self._ordered(self.words[address : address + count]))
        )[0]

    def put_number(self, address: int, value: float) -> None:
        if self.scale is None:
            self.put(address, "d", value)
        else:
            self.put(address, "i", round(value / self.scale))
            self.words[address + 2 : address + 4] = [0, 0]

    def number(self, address: int) -> float:
        return self.get(address, "d") if self.scale is None else self.get(address, "i") * self.scale

    def put_triple(self, address: int, values: tuple[float, ...]) -> None:
        for index, value in enumerate(values):
            self.put_number(address + 4 * index, value)

    def triple(self, address: int) -> tuple[float, ...]:
        return tuple(self.number(address + 4 * index) for index in range(3))

    def _prepare(self) -> None:
        self.words[1000:1002] = [0x5643, 0x0100]
        self.words[1006:1008] = [0x7F, 3]
        self.here: tuple[float, ...] = (100.0, 100.0, 100.0)
        self.put_triple(1026, self.here)
        self.words[1043] = 0xFFFF
        self.words[1052] = 1
        for place in range(8):
            self.put(1053 + 2 * place, "i", -(2**31) if place else 20125)
        self.put_triple(1100, (0.0,) * 3)
        self.put_triple(1112, (TRAVEL,) * 3)
        self.put_triple(1124, (RAPID,) * 3)
        self.put_triple(1136, (20000.0,) * 3)
        self.words[1148:1152] = [2, 20, 20, 20]
        self.put(1152, "I", 400)
        self.put_number(1154, RESOLUTION)
        self.put_number(1158, MOST_MM)

    # the server's side

    def get_holding_registers(self, address: int, number: int = 1, srv_info: object = None) -> list[int] | None:
        with self.guard:
            if not any(first <= address and address + number <= first + size for first, (size, _) in BLOCKS.items()):
                return None
            self.cycle()
            return self.words[address : address + number]

    def set_holding_registers(self, address: int, word_list: list[int], srv_info: object = None) -> bool | None:
        time.sleep(self.answer_after_s)
        with self.guard:
            end = address + len(word_list)
            writable = ((first, size) for first, (size, write) in BLOCKS.items() if write)
            if not any(first <= address and end <= first + size for first, size in writable):
                return None
            if address == 2000 and word_list[0] != self.words[2000]:
                self.heard = time.monotonic()
            self.words[address:end] = word_list
            self.cycle()
            return True

    # the program

    def cycle(self) -> None:
        words = self.words
        self._move()
        if words[2022] not in (0, self.handled):
            self.handled = words[2022]
            words[1009] = self._decide(words[2001])
            words[1008] = self.handled
        self._take_block()
        self._show_block()
        self.beat = self.beat % 0xFFFF + 1
        words[1002] = words[1069] = self.beat
        words[1003] = words[2000]
        words[1007] = 7 if math.dist(self.here, BALL) < REACH - 1e-9 else 3
        words[1006] = 0x5F if words[1004] == 3 else 0x7F
        if time.monotonic() > self.armed_until:
            words[1042] = 0
        self.put_triple(1012, self.here)

    def _decide(self, code: int) -> int:
        words, state = self.words, self.words[1004]
        if 11 <= code <= 15:
            return self._start(code)
        if 31 <= code <= 34:
            return self._table(code) if state == 0 else 3
        refused = {21: state == 3, 22: state == 3, 23: False, 24: state in (1, 2)}
        if refused.get(code, True):
            return 3 if code in refused else 2
        if code == 23 and state == 1:
            self._end(0, 6)
        if code == 24:
            words[1004] = words[1005] = 0
        return 1

    def _start(self, code: int) -> int:
        target, feed = self.triple(2006), self.number(2018)
        feed = RAPID if code in (11, 13) else feed
        reasons = {
            3: self.words[1004] != 0,
            7: not all(math.isfinite(value) for value in (*target, feed)),
            5: not all(0.0 <= value <= TRAVEL for value in target),
            6: not 0.0 < feed <= RAPID,
            10: code == 15 and self.words[1007] & 4,
        }
        for result, holds in reasons.items():
            if holds:
                return result
        self.heard = time.monotonic()
        self.motion = {"code": code, "number": self.handled, "from": self.here, "to": target, "feed": feed,
                       "since": self.heard}  # fmt: skip
        self.words[1010:1012] = [self.handled, 1]
        self.words[1004] = 1
        return 1

    def _move(self) -> None:
        motion = self.motion
        if motion is None:
            return
        length = math.dist(motion["from"], motion["to"])
        done = motion["feed"] * (time.monotonic() - motion["since"])
        trip = self._contact(motion, length) if motion["code"] >= 13 and length else math.inf
        if time.monotonic() - self.heard > 1.0:
            self._end(3, 7, 6)
        elif trip <= min(done, length):
            self.here = self._along(motion, min(trip + OVERTRAVEL, length) / length)
            self._latch(motion, 1, trip / length)
            self._end(0, 3) if motion["code"] == 15 else self._end(3, 5, 5)
        elif done >= length:
            self.here = motion["to"]
            self._latch(motion, 2, 1.0)
            self._end(0, 4 if motion["code"] == 15 else 2)
        else:
            self.here = self._along(motion, done / length)

    def _latch(self, motion: dict, result: int, share: float) -> None:
        if motion["code"] == 15:
            self.put_triple(1026, self._along(motion, share))
            self.words[1024:1026] = [motion["number"], result]

    def _end(self, state: int, outcome: int, fault: int = 0) -> None:
        self.motion = None
        self.words[1004:1006] = [state, fault]
        self.words[1011] = outcome

    def _along(self, motion: dict, share: float) -> tuple[float, ...]:
        return tuple(a + share * (b - a) for a, b in zip(motion["from"], motion["to"], strict=True))

    def _contact(self, motion: dict, length: float) -> float:
        """Return the path distance of contact with the ball, found by bisection so that no formula is shared with other
        code.
        """
        ways = [length * step / 2000 for step in range(2001)]
        inside = [math.dist(self._along(motion, way / length), BALL) < REACH for way in ways]
        entries = [index for index in range(1, 2001) if inside[index] and not inside[index - 1]]
        if not entries:
            return math.inf
        low, high = ways[entries[0] - 1], ways[entries[0]]
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (
                (low, middle) if math.dist(self._along(motion, middle / length), BALL) < REACH else (middle, high)
            )
        return high

    # tables

    def _table(self, code: int) -> int:
        words, bank = self.words, self.words[2002]
        crc = int(self.get(2004, "I"))
        result = {31: self._begin, 32: self._commit, 33: self._arm, 34: self._activate}[code](bank, crc)
        if result == 1 and code != 33:
            words[1042] = 0
        return result

    def _begin(self, bank: int, _crc: int) -> int:
        words = self.words
        if bank not in (1, 2):
            return 20
        if bank == words[1038]:
            return 21
        if words[2100] != bank or not 1 <= math.prod(words[2101:2104]) <= 400:
            return 22
        if not math.isclose(self.number(2128), RESOLUTION, rel_tol=1e-12):
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
        words = self.words
        number = words[2320]
        if number in (0, words[1044]):
            return
        if words[1040] == 0:
            words[1045] = 27
        elif number != words[1044] + 1:
            words[1045] = 23
        else:
            counts = [int(self.get(2200 + 2 * index, "i")) for index in range(60)]
            if max(map(abs, counts)) * RESOLUTION > MOST_MM:
                words[1045] = 7
                return
            self.coming += counts
            words[1044:1046] = [number, 1]

    def _commit(self, bank: int, crc: int) -> int:
        words = self.words
        descriptor, _ = self.stored.get(0, ([], []))
        if words[1040] == 0 or bank != words[1040]:
            return 27
        counts = 3 * math.prod(descriptor[1:4])
        if len(self.coming) < counts:
            return 23
        words[1040] = 0
        told = self.get(2132, "I")
        if not zlib.crc32(struct.pack(f">{counts}i", *self.coming[:counts])) == crc == told:
            words[1045 + bank] = 3
            return 24
        self.stored[bank] = (descriptor, self.coming[:counts])
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
        self.armed_until = time.monotonic() + 5.0
        self.words[1041:1043] = [bank, self.nonce]
        return 1

    def _activate(self, bank: int, _crc: int) -> int:
        words = self.words
        if words[1042] == 0 or [bank, words[2003]] != words[1041:1043]:
            return 25
        words[1038] = bank
        words[1039] = 0 if words[1039] == bank else words[1039]
        return 1

    def _show_block(self) -> None:
        bank, block = self.words[2400:2402]
        descriptor, counts = self.stored.get(bank, ([bank, *[0] * 33], [])) if bank in (1, 2) else ([], [])
        self.words[1202:1322] = [0] * 120
        part = counts[60 * (block - 1) : 60 * block] if block else []
        if bank not in (1, 2) or (block and not part):
            block = 0xFFFF
        elif block == 0:
            self.words[1202:1236] = descriptor
        for index, count in enumerate(part):
            self.put(1202 + 2 * index, "i", count)
        self.words[1200:1202] = [bank, block]


def serving(registers: IdealRegisters, port: int) -> ModbusServer:
    """Return a server on this computer, not yet started, that answers any unit."""
    return ModbusServer("127.0.0.1", port, no_block=True, data_hdl=DataHandler(registers))
