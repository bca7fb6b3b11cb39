"""Compensation tables in the Modbus registers: transfer in blocks, commit with CRC-32, and two-step activation.

Source: docs/reference/modbus-register-map.md, section 8.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil, isfinite, prod
from typing import Final

import numpy as np

from drivers.roles import Activation, StoreLimits, TableImage
from simulators.wire.modbus.numbers import RegisterNumberFormat
from simulators.wire.modbus.physics import TableMemory
from simulators.wire.modbus.register_map import (
    DESCRIPTOR_LAYOUT,
    NO_BANK_PENDING,
    ModbusBankState,
    ResultCode,
)

COUNTS_PER_BLOCK: Final = 60
BYTES_PER_BLOCK: Final = 4 * COUNTS_PER_BLOCK
ARMED_FOR_S: Final = 5.0


@dataclass(frozen=True)
class TableGridDescriptor:
    """Bank, grid, resolution and CRC-32 of one compensation table, as in registers 2100 … 2133 of the Modbus register
    map.
    """

    bank: int
    shape: tuple[int, int, int]
    origin_mm: tuple[float, float, float]
    step_mm: tuple[float, float, float]
    resolution_mm: float
    crc: int

    @classmethod
    def decode(cls, data: bytes, numbers: RegisterNumberFormat) -> TableGridDescriptor:
        bank, nx, ny, nz, grid, crc = DESCRIPTOR_LAYOUT.unpack(data)
        x, y, z, dx, dy, dz, resolution = numbers.unpack(grid)
        return cls(bank, (nx, ny, nz), (x, y, z), (dx, dy, dz), resolution, crc)

    def encode(self, numbers: RegisterNumberFormat) -> bytes:
        grid = numbers.pack(*self.origin_mm, *self.step_mm, self.resolution_mm)
        return DESCRIPTOR_LAYOUT.pack(self.bank, *self.shape, grid, self.crc)

    @property
    def nodes(self) -> int:
        return prod(self.shape)

    @property
    def blocks(self) -> int:
        return ceil(3 * self.nodes / COUNTS_PER_BLOCK)

    @property
    def finite(self) -> bool:
        return all(map(isfinite, (*self.origin_mm, *self.step_mm, self.resolution_mm)))

    def fits(self, limits: StoreLimits) -> bool:
        """Return True if the grid is within `limits` and its steps are positive.

        A step need not be positive on an axis with a single node.
        """
        within = all(1 <= n <= most for n, most in zip(self.shape, limits.max_nodes, strict=True))
        stepped = all(n == 1 or step > 0.0 for n, step in zip(self.shape, self.step_mm, strict=True))
        return within and stepped and self.nodes <= limits.max_total_nodes


@dataclass
class _Transfer:
    """Table being transferred to a bank, from TABLE BEGIN to TABLE COMMIT."""

    descriptor: TableGridDescriptor
    stored: bytearray = field(default_factory=bytearray)

    def image(self, resolution_mm: float) -> TableImage:
        d = self.descriptor
        counts = np.frombuffer(bytes(self.stored[: 12 * d.nodes]), ">i4").astype(np.int32)
        return TableImage(d.origin_mm, d.step_mm, resolution_mm, counts.reshape(*d.shape, 3))


@dataclass(frozen=True)
class CompleteTable:
    """Contents of a bank that a client can read back: the descriptor, and the big-endian counts in the register map's
    order.
    """

    image: TableImage
    descriptor: TableGridDescriptor
    counts: bytes

    @classmethod
    def of(cls, bank: int, image: TableImage) -> CompleteTable:
        counts = image.counts.astype(">i4").tobytes()
        descriptor = TableGridDescriptor(
            bank, image.shape, image.origin_mm, image.step_mm, image.resolution_mm, zlib.crc32(counts)
        )
        return cls(image, descriptor, counts)


class BankRegisters:
    """Registers of the Modbus status block that describe the banks, and the commands that change them.

    `memory` holds complete tables only. Banks with an unfinished transfer or a wrong CRC are recorded only in this
    class. A transfer cannot change the active bank of `memory`, and the table of this bank remains active during a
    transfer.
    """

    def __init__(
        self,
        memory: TableMemory,
        limits: StoreLimits,
        numbers: RegisterNumberFormat,
        now: Callable[[], float],
    ) -> None:
        self._memory = memory
        self.limits = limits
        self._numbers = numbers
        self._now = now
        (self._resolution_on_wire,) = numbers.unpack(numbers.pack(limits.resolution_mm))
        self._largest_count = int(limits.max_correction_mm / limits.resolution_mm + 1e-6)
        self._transfer: _Transfer | None = None
        self._damaged: set[int] = set()
        self._complete: dict[int, CompleteTable] = {}
        self._armed_at_s = 0.0
        self._last_nonce = 0
        self._nonce = 0
        self.armed_bank = 0
        self.staged_bank = 0
        self.pending_bank = NO_BANK_PENDING
        self.block_acknowledge = 0
        self.block_result = ResultCode.NONE_YET

    @property
    def active_bank(self) -> int:
        return self._memory.active_bank

    @property
    def open_bank(self) -> int:
        return self._transfer.descriptor.bank if self._transfer is not None else 0

    @property
    def armed_nonce(self) -> int:
        if self._nonce and self._now() - self._armed_at_s > ARMED_FOR_S:
            self._nonce = 0
        return self._nonce

    def state(self, bank: int) -> ModbusBankState:
        if bank == self.open_bank:
            return ModbusBankState.BEING_WRITTEN
        if bank in self._damaged:
            return ModbusBankState.DAMAGED
        return ModbusBankState.COMPLETE if bank in self._memory.banks else ModbusBankState.EMPTY

    def complete(self, bank: int) -> CompleteTable | None:
        """Return the table of `bank`, or None if the table is not complete."""
        if bank == 0 or self.state(bank) is not ModbusBankState.COMPLETE:
            return None
        image = self._memory.banks[bank]
        known = self._complete.get(bank)
        if known is None or known.image is not image:
            known = self._complete[bank] = CompleteTable.of(bank, image)
        return known

    def crc(self, bank: int) -> int:
        table = self.complete(bank)
        return table.descriptor.crc if table is not None else 0

    def begin(self, bank: int, descriptor_block: bytes) -> ResultCode:
        descriptor = TableGridDescriptor.decode(descriptor_block, self._numbers)
        refusal = self._refusal_to_begin(bank, descriptor)
        if refusal is not None:
            return refusal
        self._damaged |= {self.open_bank} - {0}
        self._damaged -= {bank}
        self._transfer = _Transfer(descriptor)
        if self.staged_bank == bank:
            self.staged_bank = 0
        self.block_acknowledge, self.block_result = 0, ResultCode.NONE_YET
        self._nonce = 0
        return ResultCode.ACCEPTED

    def _refusal_to_begin(self, bank: int, descriptor: TableGridDescriptor) -> ResultCode | None:
        if bank not in self.limits.banks or bank == 0:
            return ResultCode.NO_SUCH_BANK
        if bank in (self.active_bank, self.pending_bank):
            return ResultCode.BANK_IN_USE
        if not descriptor.finite:
            return ResultCode.ILLEGAL_VALUE
        same = descriptor.bank == bank and descriptor.resolution_mm == self._resolution_on_wire
        return None if same and descriptor.fits(self.limits) else ResultCode.DESCRIPTOR_NOT_ALLOWED

    def take_block(self, number: int, data: bytes) -> None:
        """Append a block of data to the table that is being transferred.

        `data` holds the contents of registers 2200 … 2319 of the Modbus register map, and `number` is the value of
        register 2320.
        """
        transfer = self._transfer
        if transfer is None:
            self.block_result = ResultCode.NO_TRANSFER
        elif number == self.block_acknowledge:
            return  # sent again because its answer was lost
        elif number != self.block_acknowledge + 1 or number > transfer.descriptor.blocks:
            self.block_result = ResultCode.BLOCKS_MISSING
        elif np.abs(np.frombuffer(data, ">i4").astype(np.int64)).max() > self._largest_count:
            self.block_result = ResultCode.ILLEGAL_VALUE
        else:
            transfer.stored += data
            self.block_result, self.block_acknowledge = ResultCode.ACCEPTED, number

    def commit(self, bank: int, crc: int) -> ResultCode:
        transfer = self._transfer
        if transfer is None or bank != transfer.descriptor.bank:
            return ResultCode.NO_TRANSFER
        if self.block_acknowledge != transfer.descriptor.blocks:
            return ResultCode.BLOCKS_MISSING
        table = CompleteTable.of(bank, transfer.image(self.limits.resolution_mm))
        self._transfer = None
        if not table.descriptor.crc == crc == transfer.descriptor.crc:
            self._damaged.add(bank)
            return ResultCode.CRC_DIFFERS
        self._memory.write_bank(bank, table.image)
        self.staged_bank = bank
        self._nonce = 0
        return ResultCode.ACCEPTED

    def arm(self, bank: int, crc: int) -> ResultCode:
        if bank != 0 and bank not in self.limits.banks:
            return ResultCode.NO_SUCH_BANK
        if bank != 0 and self.state(bank) is not ModbusBankState.COMPLETE:
            return ResultCode.NOT_COMPLETE
        if crc != self.crc(bank):
            return ResultCode.CRC_DIFFERS
        self._last_nonce = self._last_nonce % 0xFFFF + 1
        self.armed_bank, self._nonce, self._armed_at_s = bank, self._last_nonce, self._now()
        return ResultCode.ACCEPTED

    def activate(self, bank: int, nonce: int) -> ResultCode:
        armed = self.armed_nonce
        if not armed or nonce != armed or bank != self.armed_bank:
            return ResultCode.NOT_ARMED
        self._nonce, self.armed_bank = 0, 0
        if self.limits.activation is Activation.IMMEDIATE:
            self._memory.activate(bank)
        else:
            self.pending_bank = bank
        if self.staged_bank == bank:
            self.staged_bank = 0
        return ResultCode.ACCEPTED

    def occurred(self, event: Activation) -> None:
        """Handle a power-up or a referencing. If the activation of a bank waits for this event, the bank becomes
        active.
        """
        if event is self.limits.activation and self.pending_bank != NO_BANK_PENDING:
            self._memory.activate(self.pending_bank)
            self.pending_bank = NO_BANK_PENDING
