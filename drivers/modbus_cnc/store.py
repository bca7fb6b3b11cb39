"""Compensation store with two banks in a Modbus controller.

A table is written in blocks through a group of registers (the data window) and is activated in two steps, arm and
confirm. It is read back block by block through the read window, a range of registers that shows one selected block.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator

import numpy as np

from drivers.clock import Deadline
from drivers.errors import (
    ChecksumMismatch,
    CommandRejected,
    ProtocolError,
    ReadBackMismatch,
    StoreError,
)
from drivers.modbus_cnc.codes import (
    ACCEPTED,
    ACTIVATIONS,
    CRC_DIFFERS,
    NO_BANK,
    NO_BLOCK,
    BankState,
    CommandCode,
    result_text,
)
from drivers.modbus_cnc.registers import CommandBlock, ControllerLimits, StatusImage, TableDescriptor
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import READ_WINDOW_REGISTERS
from drivers.roles import Activation, StoreLimits, TableImage
from drivers.tables.checks import limits_violation

BLOCK_BYTES = 240
"""Size of a data block: 120 registers hold 60 counts, that is 20 nodes."""


def table_bytes(table: TableImage) -> bytes:
    """Return all counts (integer corrections) of a table as big-endian int32. The node index varies fastest along z and
    slowest along x.

    Each node has its counts in the order dx, dy, dz (docs/reference/modbus-register-map.md, section 8).
    """
    return table.counts.astype(">i4").tobytes(order="C")


def crc32(data: bytes) -> int:
    return zlib.crc32(data)


def block_count(nodes: tuple[int, int, int]) -> int:
    nx, ny, nz = nodes
    # Three corrections of 4 bytes at each node; -(-a // b) rounds up.
    return -(-nx * ny * nz * 12 // BLOCK_BYTES)


def data_blocks(data: bytes) -> Iterator[bytes]:
    """Yield `data`, the bytes of a table, in blocks of `BLOCK_BYTES` bytes. The last block is padded with zeros."""
    for start in range(0, len(data), BLOCK_BYTES):
        yield data[start : start + BLOCK_BYTES].ljust(BLOCK_BYTES, b"\x00")


def table_descriptor(bank: int, table: TableImage, crc: int) -> TableDescriptor:
    return TableDescriptor(bank, table.shape, table.origin_mm, table.step_mm, table.resolution_mm, crc)


def decode_table(descriptor: TableDescriptor, data: bytes) -> TableImage:
    """Return the table with the grid of `descriptor` and the counts in `data`, which holds 12 bytes per node."""
    counts = np.frombuffer(data, dtype=">i4").astype(np.int32).reshape(*descriptor.nodes, 3)
    return TableImage(descriptor.origin, descriptor.step, descriptor.resolution, counts)


COARSEST_POLL_S = 0.1


class ModbusStore:
    """Compensation store in the controller to which `session` is connected."""

    def __init__(self, session: ModbusSession, limits: ControllerLimits) -> None:
        self._session = session
        self._reader = BankReader(session, limits.max_total_nodes)
        self._limits = StoreLimits(
            banks=tuple(range(1, limits.banks + 1)),
            max_nodes=limits.max_nodes,
            max_total_nodes=limits.max_total_nodes,
            resolution_mm=limits.resolution,
            max_correction_mm=limits.max_correction,
            activation=ACTIVATIONS[limits.activation],
        )

    def store_limits(self) -> StoreLimits:
        return self._limits

    def active_bank(self) -> int:
        """Return the active bank. Raises ProtocolError if the controller states a bank that it does not have: the
        answer was altered on its way, or the controller does not follow the register map."""
        return self._one_of_its_own(self._session.status().active_bank)

    def pending_bank(self) -> int | None:
        """Return the pending bank, or None if no activation is pending. Raises ProtocolError as `active_bank` does."""
        pending = self._session.status().pending_bank
        return None if pending == NO_BANK else self._one_of_its_own(pending)

    def read_table(self, bank: int) -> TableImage | None:
        """Return the table of `bank`, or None for bank 0 and for an inactive bank without a complete table.

        Raises StoreError if the active bank has no complete table.
        """
        if bank == 0:
            return None
        self._require_known(bank)
        status = self._session.status()
        if status.bank_state(bank) is not BankState.COMPLETE:
            if bank == status.active_bank:
                raise self._error(f"the active bank {bank} holds no complete table")
            return None
        return self._reader.read(bank)[0]

    def stage(self, bank: int, table: TableImage) -> None:
        """Transfer a table to an inactive bank, commit the table and read it back.

        Raises StoreError if the table is refused, ChecksumMismatch if the controller finds a different CRC-32, and
        ReadBackMismatch if the table read back differs.
        """
        self._require_stageable(bank, table)
        data = table_bytes(table)
        crc = crc32(data)
        descriptor = self._pack_descriptor(table_descriptor(bank, table, crc))
        settings = self._session.settings
        self._session.link.write(settings.blocks.descriptor, descriptor, idempotent=True)
        self._table_command(CommandBlock(CommandCode.TABLE_BEGIN, bank=bank))
        for number, block in enumerate(data_blocks(data), start=1):
            self._write_block(number, block)
        self._commit(bank, crc)
        self._verify_read_back(bank, descriptor, data)

    def activate(self, bank: int) -> None:
        """Activate a bank in two steps, and return when it is active.

        The bank is first armed with the CRC-32 of its table, which is read for this purpose. The activation is then
        confirmed with the nonce (a number used once) that the controller shows for the armed bank. If the controller
        does not activate immediately, the method returns when the bank is pending: it becomes active at the next reset,
        power-up or referencing.
        """
        crc = 0
        if bank != 0:
            self._require_known(bank)
            if self._session.status().bank_state(bank) is not BankState.COMPLETE:
                raise self._error(f"bank {bank} holds no complete table", hint="stage it first")
            crc = crc32(table_bytes(self._reader.read(bank)[0]))
        status = self._table_command(CommandBlock(CommandCode.TABLE_ARM, bank=bank, crc=crc))
        if status.armed_bank != bank or status.armed_nonce == 0:
            raise self._protocol_error(
                f"armed bank {bank}, but the controller shows bank {status.armed_bank} nonce {status.armed_nonce}"
            )
        status = self._table_command(CommandBlock(CommandCode.TABLE_ACTIVATE, bank=bank, nonce=status.armed_nonce))
        immediate = self._limits.activation is Activation.IMMEDIATE
        self._await(
            status,
            lambda image: (image.active_bank if immediate else image.pending_bank) == bank,
            f"bank {bank} to become {'active' if immediate else 'pending'}",
        )

    def _write_block(self, number: int, block: bytes) -> None:
        session = self._session
        data = session.layouts.block.reordered(block) + number.to_bytes(2, "big")
        status = session.write_and_read_status(session.settings.blocks.data_window, data, idempotent=True)
        self._await(status, lambda image: self._block_taken(number, image), f"data block {number} to be accepted")

    def _block_taken(self, number: int, status: StatusImage) -> bool:
        if status.block_acknowledge == number:
            return True
        if status.block_result not in (0, ACCEPTED):
            raise self._error(f"data block {number} refused: {result_text(status.block_result)}")
        if status.block_acknowledge != number - 1:
            raise self._protocol_error(
                f"wrote data block {number}, but the controller acknowledges {status.block_acknowledge}"
            )
        return False

    def _commit(self, bank: int, crc: int) -> None:
        status = self._table_command(CommandBlock(CommandCode.TABLE_COMMIT, bank=bank, crc=crc))
        if status.staged_bank != bank or status.bank_state(bank) is not BankState.COMPLETE:
            raise self._protocol_error(
                f"committed bank {bank}, but the controller shows staged bank {status.staged_bank}, "
                f"state {status.bank_state(bank).name.lower()}"
            )

    def _verify_read_back(self, bank: int, descriptor: bytes, data: bytes) -> None:
        table, seen = self._reader.read(bank)
        if self._pack_descriptor(seen) != descriptor or table_bytes(table) != data:
            raise ReadBackMismatch(
                f"bank {bank} reads back differently from what was written",
                hint="do not activate it; stage it again",
                bank=bank,
                **self._session.where,
            )

    def _table_command(self, command: CommandBlock) -> StatusImage:
        try:
            return self._session.command(command, within_s=self._session.settings.table_timeout_s)
        except CommandRejected as refusal:
            kind = ChecksumMismatch if refusal.where.get("result") == str(CRC_DIFFERS) else StoreError
            raise kind(
                refusal.message,
                hint="the active bank is unchanged; see the event log of the controller",
                bank=command.bank,
                **self._session.where,
            ) from refusal

    def _await(self, status: StatusImage, reached: Callable[[StatusImage], bool], awaited: str) -> None:
        clock, settings = self._session.clock, self._session.settings
        deadline = Deadline.after(clock, settings.table_timeout_s)
        pause_s = settings.fine_poll_interval_s
        while not reached(status):
            deadline.raise_if_expired(awaited, **self._session.where)
            clock.sleep(pause_s)
            pause_s = min(2.0 * pause_s, COARSEST_POLL_S)
            status = self._session.status()

    def _pack_descriptor(self, descriptor: TableDescriptor) -> bytes:
        try:
            return self._session.layouts.descriptor.pack(descriptor)
        except ValueError as error:
            raise self._error("the table does not fit the controller's registers") from error

    def _one_of_its_own(self, bank: int) -> int:
        banks = len(self._limits.banks)
        if not 0 <= bank <= banks:
            raise ProtocolError(
                f"the controller names bank {bank}, but it has {banks} banks",
                hint="an answer was altered on its way, or the controller does not follow the register map",
                **self._session.where,
            )
        return bank

    def _require_known(self, bank: int) -> None:
        if bank not in self._limits.banks:
            raise self._error(f"no bank {bank}; the controller has {self._limits.banks}")

    def _require_stageable(self, bank: int, table: TableImage) -> None:
        self._require_known(bank)
        if bank == self._session.status().active_bank:
            raise self._error(f"bank {bank} is active and cannot be written", hint="stage into another bank")
        objection = limits_violation(self._limits, table)
        if objection:
            raise self._error(objection)

    def _error(self, text: str, hint: str = "") -> StoreError:
        return StoreError(text, hint=hint, **self._session.where)

    def _protocol_error(self, text: str) -> ProtocolError:
        return ProtocolError(text, hint="the controller does not follow the register map", **self._session.where)


class BankReader:
    """Reader of the banks of a controller that contain a complete compensation table, of `max_total_nodes` at most.

    Block 0 of a bank is the descriptor of the table (its grid and its CRC-32); the further blocks contain its
    corrections.
    """

    def __init__(self, session: ModbusSession, max_total_nodes: int) -> None:
        self._session = session
        self._max_total_nodes = max_total_nodes

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
        # The last block is padded. The CRC covers the counts alone, in big-endian order whatever the order on the wire.
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
        # A table of more nodes than the controller has would be read for ever.
        fits = min(descriptor.nodes) >= 1 and math.prod(descriptor.nodes) <= self._max_total_nodes
        sound = all(map(math.isfinite, numbers)) and fits
        if descriptor.bank != bank or not sound:
            raise self._protocol_error(f"the descriptor of bank {bank} is invalid: {descriptor}")

    def _protocol_error(self, text: str) -> ProtocolError:
        return ProtocolError(text, hint="the controller does not follow the register map", **self._session.where)
