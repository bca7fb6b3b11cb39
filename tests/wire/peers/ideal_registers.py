"""Ideal machine with one ball: the registers of `modbus_registers` on the wall clock, behind pyModbusTCP."""

from __future__ import annotations

import math
import threading
import time
from itertools import pairwise

from modbus_registers import ControllerRegisters, Point, along, inside_a_block
from pyModbusTCP.server import DataBank, DataHandler, ModbusServer

BALL, REACH = (250.0, 250.0, 100.0), 15.5


class BallMachine(ControllerRegisters):
    overtravel_mm = 0.05

    def cycle(self) -> None:
        super().cycle()
        self.registers[1007] = 7 if math.dist(self.here, BALL) < REACH - 1e-9 else 3
        self.registers[1006] = 0x5F if self.registers[1004] == 3 else 0x7F

    def trip_distance_mm(self, start: Point, end: Point) -> float:
        """Return the path distance of contact with the ball, found by bisection so that no formula is shared with other
        code.
        """
        length = math.dist(start, end)

        def inside(way: float) -> bool:
            return math.dist(along(start, end, way / length), BALL) < REACH

        ways = [length * step / 2000 for step in range(2001)]
        entries = [(low, high) for low, high in pairwise(ways) if inside(high) and not inside(low)]
        if not entries:
            return math.inf
        low, high = entries[0]
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (low, middle) if inside(middle) else (middle, high)
        return high


class IdealRegisters(DataBank):
    """Registers of the ideal machine; the arguments are those of `ControllerRegisters`."""

    def __init__(self, scale: float | None = None, *, low_word: bool = False, low_byte: bool = False) -> None:
        super().__init__(h_regs_size=2402, coils_size=1, d_inputs_size=1, i_regs_size=1)
        self.machine = BallMachine(time.monotonic, scale, low_word=low_word, low_byte=low_byte)
        self.guard = threading.RLock()
        self.answer_after_s = 0.0

    def get_holding_registers(self, address: int, number: int = 1, srv_info: object = None) -> list[int] | None:
        with self.guard:
            if not inside_a_block(address, number, write=False):
                return None
            self.machine.cycle()
            return self.machine.registers[address : address + number]

    def set_holding_registers(self, address: int, word_list: list[int], srv_info: object = None) -> bool | None:
        time.sleep(self.answer_after_s)
        with self.guard:
            if not inside_a_block(address, len(word_list), write=True):
                return None
            self.machine.write(address, word_list)
            self.machine.cycle()
            return True


def serving(registers: IdealRegisters, port: int) -> ModbusServer:
    """Return a server on this computer, not yet started, that answers any unit."""
    return ModbusServer("127.0.0.1", port, no_block=True, data_hdl=DataHandler(registers))
