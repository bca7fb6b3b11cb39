"""Reader of compensation tables in the banks of a controller.

A table is read block by block through the read window, a range of registers that shows one selected block.
"""

from __future__ import annotations

import math

from drivers.clock import Deadline
from drivers.errors import ChecksumMismatch, ProtocolError
from drivers.modbus_cnc.codes import NO_BLOCK
from drivers.modbus_cnc.registers import TableDescriptor
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import READ_WINDOW_REGISTERS
from drivers.modbus_cnc.table import block_count, crc32, decode_table
from drivers.roles import TableImage


class BankReader:
    """Reader of the banks of a controller that contain a complete compensation table.

    Block 0 of a bank is the descriptor of the table (its grid and its CRC-32); the further blocks contain its
    corrections.
    """

    def __init__(self, session: ModbusSession) -> None:
        self._session = session

    def read(self, bank: int) -> tuple[TableImage, TableDescriptor]:
        """Read a complete bank, and return its compensation table and the descriptor of this table.

        Raises ChecksumMismatch if the CRC-32 of the data read differs from the CRC-32 in the descriptor. Raises
        ProtocolError if a block is missing or the descriptor is invalid.
        """
        layout = self._session.layouts.descriptor
        descriptor = TableDescriptor(*layout.unpack(self._read_block(bank, 0)[: 2 * layout.size]))
        self._require_sound(bank, descriptor)
        nx, ny, nz = descriptor.nodes
        blocks = [self._read_block(bank, number + 1) for number in range(block_count(descriptor.nodes))]
        reordered = self._session.layouts.block.reordered
        data = b"".join(reordered(block) for block in blocks)[: nx * ny * nz * 12]
        if crc32(data) != descriptor.crc:
            raise ChecksumMismatch(
                f"bank {bank}: the CRC-32 of the data read is {crc32(data):08X}, "
                f"the controller states {descriptor.crc:08X}",
                hint="read again; if the difference remains, stage the table again",
                bank=bank,
                **self._session.where,
            )
        return decode_table(descriptor, data), descriptor

    def _read_block(self, bank: int, number: int) -> bytes:
        """Select block `number` of `bank`, wait until the read window shows it, and return its 240 bytes.

        Until the controller's program evaluates the selector, the window shows the previous selection. A report that
        there is no such block therefore counts only after `acknowledge_timeout_s`.
        """
        blocks, clock = self._session.settings.blocks, self._session.clock
        selector = bank.to_bytes(2, "big") + number.to_bytes(2, "big")
        deadline = Deadline.after(clock, self._session.settings.table_timeout_s)
        seen_by_then = Deadline.after(clock, self._session.settings.acknowledge_timeout_s)
        while True:
            window = self._session.link.exchange(
                blocks.read_selector, selector, blocks.read_window, READ_WINDOW_REGISTERS, idempotent=True
            )
            if window[:4] == selector:
                return window[4:]
            if int.from_bytes(window[2:4], "big") == NO_BLOCK and seen_by_then.expired:
                raise self._protocol_error(f"the controller has no block {number} of bank {bank}")
            deadline.raise_if_expired(f"block {number} of bank {bank} in the read window", **self._session.where)
            clock.sleep(self._session.settings.fine_poll_interval_s)

    def _require_sound(self, bank: int, descriptor: TableDescriptor) -> None:
        numbers = (*descriptor.origin, *descriptor.step, descriptor.resolution)
        sound = all(map(math.isfinite, numbers)) and min(descriptor.nodes) >= 1
        if descriptor.bank != bank or not sound:
            raise self._protocol_error(f"the descriptor of bank {bank} is invalid: {descriptor}")

    def _protocol_error(self, text: str) -> ProtocolError:
        return ProtocolError(text, hint="the controller does not follow the register map", **self._session.where)
