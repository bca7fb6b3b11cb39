"""Compensation store with two banks in a Modbus controller.

A table is transferred in blocks through a group of registers (the data window) and is activated in two steps, arm and
confirm.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.clock import Deadline
from drivers.errors import (
    ChecksumMismatch,
    CommandRejected,
    ProtocolError,
    ReadBackMismatch,
    StoreError,
)
from drivers.modbus_cnc.bank_reader import BankReader
from drivers.modbus_cnc.codes import (
    ACCEPTED,
    ACTIVATIONS,
    CRC_DIFFERS,
    NO_BANK,
    BankState,
    CommandCode,
    result_text,
)
from drivers.modbus_cnc.registers import CommandBlock, ControllerLimits, StatusImage, TableDescriptor
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.table import crc32, data_blocks, table_bytes, table_descriptor
from drivers.roles import Activation, StoreLimits, TableImage
from drivers.tables.checks import limits_violation

COARSEST_POLL_S = 0.1


class ModbusStore:
    """Compensation store in the controller to which `session` is connected."""

    def __init__(self, session: ModbusSession, limits: ControllerLimits) -> None:
        self._session = session
        self._reader = BankReader(session)
        self._limits = StoreLimits(
            banks=tuple(range(1, limits.banks + 1)),
            max_nodes=limits.max_nodes,
            max_total_nodes=limits.max_total_nodes,
            resolution_mm=limits.resolution,
            max_correction_mm=limits.max_correction,
            activation=ACTIVATIONS[limits.activation],
        )

    @property
    def limits(self) -> StoreLimits:
        return self._limits

    def active_bank(self) -> int:
        return self._session.status().active_bank

    def pending_bank(self) -> int | None:
        pending = self._session.status().pending_bank
        return None if pending == NO_BANK else pending

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
            raise self._error(f"the table does not fit the controller's registers: {error}") from error

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
