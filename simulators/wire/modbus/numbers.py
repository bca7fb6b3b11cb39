"""Encoding of a number in four registers, either as a float64 or, for controllers without float64, as a scaled int32.

Source: docs/reference/modbus-register-map.md, section 1.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from decimal import Decimal
from typing import Protocol

BYTES_PER_NUMBER = 8


class RegisterNumberFormat(Protocol):
    """Codec for the ``f64`` type of the Modbus register map: four registers, eight bytes, high word first."""

    def pack(self, *values: float) -> bytes: ...

    def unpack(self, data: bytes) -> tuple[float, ...]: ...


class Float64Numbers:
    """Encoding of a number as IEEE 754 binary64 in four registers."""

    def pack(self, *values: float) -> bytes:
        return struct.pack(f">{len(values)}d", *values)

    def unpack(self, data: bytes) -> tuple[float, ...]:
        return struct.unpack(f">{len(data) // BYTES_PER_NUMBER}d", data)


@dataclass(frozen=True)
class ScaledInt32Numbers:
    """Encoding of a number, which occupies four registers, as an int32 in the first two of them.

    The number is the int32 times `scale`.

    The other two registers are 0.
    """

    scale: float = 1e-5

    def pack(self, *values: float) -> bytes:
        return struct.pack(">" + "i4x" * len(values), *(round(value / self.scale) for value in values))

    def unpack(self, data: bytes) -> tuple[float, ...]:
        counts = struct.unpack(">" + "i4x" * (len(data) // BYTES_PER_NUMBER), data)
        unit = Decimal(repr(self.scale))  # so that 50 000 000 counts of 0.00001 are 500, not its neighbour
        return tuple(float(count * unit) for count in counts)
