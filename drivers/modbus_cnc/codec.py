"""Conversion between blocks of Modbus registers and typed values.

Each block is packed or unpacked by one `struct` call, for any number type (float64 or scaled int32) and any order of
the registers within a value.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

RegisterType = Literal["u16", "u32", "i32", "number"]
WordOrder = Literal["high-first", "low-first"]

_REGISTERS = {"u16": 1, "u32": 2, "i32": 2, "number": 4}


@dataclass(frozen=True)
class NumberFormat:
    """Format in which floating-point values (type f64 of docs/reference/modbus-register-map.md) are transmitted.

    Each such value occupies four registers. Either the four registers hold a float64, or the first two hold an int32,
    as stated by `kind`. An int32 is multiplied by `scale` to give the value. `word_order` is the order of the registers
    of a value, and `byte_order` is the order of the two bytes in each register. Both orders apply to every value of
    more than one register. A value of type u16 is always big-endian.
    """

    kind: Literal["float64", "int32"] = "float64"
    scale: float = 1e-5
    word_order: WordOrder = "high-first"
    byte_order: WordOrder = "high-first"


@dataclass(frozen=True)
class RegisterField:
    """Named field of a register block. Its value is a scalar if `count` is 1, otherwise a tuple of `count` values."""

    name: str
    kind: RegisterType
    count: int = 1


class RegisterLayout:
    """Layout of one block of consecutive registers: its fields, in order."""

    def __init__(self, registers: Sequence[RegisterField], numbers: NumberFormat) -> None:
        self._registers = tuple(registers)
        self._numbers = numbers
        # "i4x": an int32 in the first two registers of a number, and four bytes that are not used
        codes = {"u16": "H", "u32": "I", "i32": "i", "number": "d" if numbers.kind == "float64" else "i4x"}
        # Repeat the code of each item instead of giving a count: "3d" would work, "3i4x" would not.
        self._struct = struct.Struct(">" + "".join(codes[kind] for kind in self._kinds()))
        swapped = "low-first" in (numbers.word_order, numbers.byte_order)
        self._order = tuple(self._swapped_bytes()) if swapped else None
        scaled = numbers.kind == "int32"
        self._scaled = tuple(index for index, kind in enumerate(self._kinds()) if scaled and kind == "number")

    @property
    def size(self) -> int:
        """Number of registers in a block with this layout."""
        return self._struct.size // 2

    def offset(self, name: str) -> int:
        """Return the offset, in registers, of the field `name` from the start of the block."""
        offset = 0
        for register in self._registers:
            if register.name == name:
                return offset
            offset += _REGISTERS[register.kind] * register.count
        raise KeyError(name)

    def unpack(self, data: bytes) -> Iterator[Any]:
        """Yield the value of each field in order: an int, a float, or a tuple if the field has several values."""
        flat: Sequence[Any] = self._struct.unpack(self.reordered(data))
        if self._scaled:
            values = list(flat)
            for index in self._scaled:
                values[index] *= self._numbers.scale
            flat = values
        at = 0
        for register in self._registers:
            yield flat[at] if register.count == 1 else tuple(flat[at : at + register.count])
            at += register.count

    def pack(self, values: Sequence[Any]) -> bytes:
        """Pack one value per field into bytes, as the inverse of `unpack`. Raises ValueError if a value does not fit
        its field.
        """
        flat: list[Any] = []
        for register, value in zip(self._registers, values, strict=True):
            flat.extend((value,) if register.count == 1 else value)
        for index in self._scaled:
            # to the nearest count; truncation would shift every position by half a count on average
            flat[index] = round(flat[index] / self._numbers.scale)
        try:
            return self.reordered(self._struct.pack(*flat))
        except struct.error as error:
            raise ValueError(str(error)) from error

    def reordered(self, data: bytes) -> bytes:
        """Return the bytes of the whole block, converted from big-endian order to the order of transmission (wire
        order).

        The same swap of bytes converts wire order back to big-endian order.
        """
        return data if self._order is None else bytes([data[index] for index in self._order])

    def _kinds(self) -> Iterator[RegisterType]:
        for register in self._registers:
            yield from (register.kind,) * register.count

    def _swapped_bytes(self) -> Iterator[int]:
        words_reversed = self._numbers.word_order == "low-first"
        low_byte_first = self._numbers.byte_order == "low-first"
        at = 0
        for kind in self._kinds():
            registers = _REGISTERS[kind]
            # Only the registers that carry the value change places; the two unused registers of an int32 stay last.
            valued = 2 if kind == "number" and self._numbers.kind == "int32" else registers
            words = [*(range(valued - 1, -1, -1) if words_reversed else range(valued)), *range(valued, registers)]
            # a u16 is big-endian on every controller: the Modbus specification defines it so
            first, second = (1, 0) if low_byte_first and registers > 1 else (0, 1)
            for word in words:
                yield from (at + 2 * word + first, at + 2 * word + second)
            at += 2 * registers
