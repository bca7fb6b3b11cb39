"""Holding registers of the simulated controller: byte images of the blocks, and the effects of writing to them.

Source: docs/reference/modbus-register-map.md, sections 2 to 6 and 8.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import structlog

from drivers.errors import ConfigurationError, DeviceError
from drivers.roles import Activation, AxisLimits, StoreLimits
from simulators.wire.modbus.frames import RegisterAccessError
from simulators.wire.modbus.motion import MotionRegisters, MotionRequest
from simulators.wire.modbus.numbers import RegisterNumberFormat
from simulators.wire.modbus.physics import ControllerPhysics
from simulators.wire.modbus.register_map import (
    BLOCK_NUMBER_REGISTER,
    COMMAND,
    COMMAND_LAYOUT,
    DATA_WINDOW,
    DESCRIPTOR,
    LIMITS,
    LIMITS_LAYOUT,
    MOTION_COMMANDS,
    NO_SUCH_BLOCK,
    NO_TEMPERATURE,
    PROTOCOL,
    READ_SELECTOR,
    READ_WINDOW,
    SEQUENCE_REGISTER,
    STATUS,
    STATUS_LAYOUT,
    TEMPERATURE_SLOTS,
    VERSION,
    ModbusCommandCode,
    ModbusExceptionCode,
    RegisterBlock,
    ResultCode,
)
from simulators.wire.modbus.tables import BYTES_PER_BLOCK, BankRegisters

log = structlog.get_logger()

BLOCKS: Final = (STATUS, COMMAND, READ_WINDOW, DATA_WINDOW, READ_SELECTOR, DESCRIPTOR, LIMITS)
USUAL_TEMPERATURES: Final = ("artefact", "ambient", "machine")
ACTIVATION_CODE: Final = {
    Activation.IMMEDIATE: 0,
    Activation.RESET: 1,
    Activation.POWER_CYCLE: 2,
    Activation.REFERENCE: 3,
}


class ControllerRegisters:
    """Registers of the simulated controller, which are read and written by address as bytes. The caller must hold the
    lock of the simulated world.
    """

    def __init__(self, machine: ControllerPhysics, numbers: RegisterNumberFormat, now: Callable[[], float]) -> None:
        self._machine = machine
        self._numbers = numbers
        _require_representable(machine.store_limits)
        self.motion = MotionRegisters(machine, now)
        self.tables = BankRegisters(machine, machine.store_limits, numbers, now)
        self._limits = limits_image(machine.limits(), machine.store_limits, numbers)
        self._written = {block: bytearray(2 * block.registers) for block in BLOCKS if block.writable}
        self._heartbeat = 0
        self._handled_sequence = 0
        self._acknowledge = 0
        self._result = ResultCode.NONE_YET
        self._commands: dict[ModbusCommandCode, Callable[[int, int, int], ResultCode]] = {
            ModbusCommandCode.HOLD: lambda _bank, _nonce, _crc: self.motion.hold(),
            ModbusCommandCode.RESUME: lambda _bank, _nonce, _crc: self.motion.resume(),
            ModbusCommandCode.STOP: lambda _bank, _nonce, _crc: self.motion.stop(),
            ModbusCommandCode.RESET: lambda _bank, _nonce, _crc: self._reset(),
            ModbusCommandCode.TABLE_BEGIN: lambda bank, _nonce, _crc: self._begin(bank),
            ModbusCommandCode.TABLE_COMMIT: lambda bank, _nonce, crc: self.tables.commit(bank, crc),
            ModbusCommandCode.TABLE_ARM: lambda bank, _nonce, crc: self.tables.arm(bank, crc),
            ModbusCommandCode.TABLE_ACTIVATE: lambda bank, nonce, _crc: self.tables.activate(bank, nonce),
        }

    def check_read(self, address: int, count: int) -> None:
        _block_of(address, count)

    def check_write(self, address: int, count: int) -> None:
        if not _block_of(address, count).writable:
            raise RegisterAccessError(ModbusExceptionCode.ILLEGAL_ADDRESS)

    def read(self, address: int, count: int) -> bytes:
        block = _block_of(address, count)
        return self._image(block)[block.slice_of(address, count)]

    def _image(self, block: RegisterBlock) -> bytes:
        if block is STATUS:
            return self._status()
        if block is LIMITS:
            return self._limits
        if block is READ_WINDOW:
            return self._read_window()
        return bytes(self._written[block])

    def write(self, address: int, data: bytes) -> None:
        block = _block_of(address, len(data) // 2)
        image = self._written[block]
        heartbeat_before = bytes(image[:2])
        image[block.slice_of(address, len(data) // 2)] = data
        last = address + len(data) // 2 - 1
        if block is COMMAND:
            self.motion.observe()
            if image[:2] != heartbeat_before:
                self.motion.heartbeat_changed()
            if last == SEQUENCE_REGISTER:
                self._sequence_seen()
        elif block is DATA_WINDOW and last == BLOCK_NUMBER_REGISTER:
            number = int.from_bytes(image[BYTES_PER_BLOCK:], "big")
            self.tables.take_block(number, bytes(image[:BYTES_PER_BLOCK]))

    def _sequence_seen(self) -> None:
        _, code, bank, nonce, crc, target, feed, sequence = COMMAND_LAYOUT.unpack(self._written[COMMAND])
        if sequence in (0, self._handled_sequence):
            return
        self._handled_sequence = sequence
        self._result = self._execute(code, (bank, nonce, crc), target + feed, sequence)
        self._acknowledge = sequence

    def _execute(self, code: int, table: tuple[int, int, int], motion: bytes, sequence: int) -> ResultCode:
        try:
            command = ModbusCommandCode(code)
        except ValueError:
            return ResultCode.UNKNOWN_COMMAND
        try:
            if command in MOTION_COMMANDS:
                *target, feed = self._numbers.unpack(motion)
                return self.motion.start(MotionRequest(command, tuple(target), feed, tag=table[2]), sequence)
            if command >= ModbusCommandCode.TABLE_BEGIN and self.motion.state:
                return ResultCode.NOT_IN_THIS_STATE
            return self._commands[command](*table)
        except DeviceError as error:
            log.warning("the machine refused", command=command.name, reason=str(error))
            return ResultCode.NOT_IN_THIS_STATE

    def _begin(self, bank: int) -> ResultCode:
        result = self.tables.begin(bank, bytes(self._written[DESCRIPTOR]))
        if result is ResultCode.ACCEPTED:
            self._written[DATA_WINDOW][BYTES_PER_BLOCK:] = b"\0\0"
        return result

    def _reset(self) -> ResultCode:
        result = self.motion.reset()
        if result is ResultCode.ACCEPTED:
            self.tables.occurred(Activation.RESET)
        return result

    def _status(self) -> bytes:
        """Return a new image of STATUS, so that every request is answered with the present state of the machine."""
        motion, tables = self.motion, self.tables
        motion.observe()
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        nonce = tables.armed_nonce
        temperatures = self._machine.temperatures()
        return STATUS_LAYOUT.pack(
            PROTOCOL,
            VERSION,
            self._heartbeat,
            int.from_bytes(self._written[COMMAND][:2], "big"),
            motion.state,
            motion.fault,
            motion.permissions,
            motion.probe,
            self._acknowledge,
            self._result,
            motion.sequence,
            motion.outcome,
            self._numbers.pack(*motion.position_mm()),
            motion.latch_sequence,
            motion.latch_result,
            self._numbers.pack(*motion.latched_mm),
            tables.active_bank,
            tables.staged_bank,
            tables.open_bank,
            tables.armed_bank if nonce else 0,
            nonce,
            tables.pending_bank,
            tables.block_acknowledge,
            tables.block_result,
            tables.state(1),
            tables.state(2),
            tables.crc(1),
            tables.crc(2),
            min(len(temperatures), TEMPERATURE_SLOTS),
            *temperature_counts(temperatures),
            self._heartbeat,
        )

    def _read_window(self) -> bytes:
        """Return the image of registers 1200 … 1321 (bank, block number, data) for the block requested by READ
        SELECTOR.
        """
        selector = self._written[READ_SELECTOR]
        bank, block = int.from_bytes(selector[:2], "big"), int.from_bytes(selector[2:], "big")
        data = self._table_block(bank, block)
        number = NO_SUCH_BLOCK if data is None else block
        return bytes(selector[:2]) + number.to_bytes(2, "big") + (data or b"").ljust(BYTES_PER_BLOCK, b"\0")

    def _table_block(self, bank: int, block: int) -> bytes | None:
        if bank not in self.tables.limits.banks or bank == 0:
            return None
        table = self.tables.complete(bank)
        if block == 0:
            return table.descriptor.encode(self._numbers) if table is not None else bank.to_bytes(2, "big")
        if table is None or block > table.descriptor.blocks:
            return None
        return table.counts[BYTES_PER_BLOCK * (block - 1) : BYTES_PER_BLOCK * block]


def _require_representable(store: StoreLimits) -> None:
    """Raise ConfigurationError unless the store fits the register map.

    It must have banks 1 and 2 or no banks, and at most 65535 nodes along an axis.
    """
    if sorted(store.banks) not in ([], [1, 2]) or max(store.max_nodes) > 0xFFFF:
        raise ConfigurationError(
            f"a store with banks {list(store.banks)} and {store.max_nodes} nodes does not fit the register map",
            key="store",
            hint="use banks 1 and 2, and at most 65535 nodes along an axis",
        )


def limits_image(axes: AxisLimits, store: StoreLimits, numbers: RegisterNumberFormat) -> bytes:
    """Return the bytes of registers 1100 … 1162 of the Modbus register map, a block that holds the limits of the
    controller.
    """
    travel = numbers.pack(*axes.lower_mm, *axes.upper_mm, *axes.rapid_mm_per_s, *axes.acceleration_mm_per_s2)
    return LIMITS_LAYOUT.pack(
        travel,
        len([bank for bank in store.banks if bank != 0]),
        *store.max_nodes,
        store.max_total_nodes,
        numbers.pack(store.resolution_mm, store.max_correction_mm),
        ACTIVATION_CODE[store.activation],
    )


def temperature_counts(temperatures: Mapping[str, float]) -> list[int]:
    """Return eight temperatures in thousandths of a degree Celsius, filled up with `NO_TEMPERATURE` (the value for a
    missing sensor).

    The temperatures of artefact, ambient and machine come first. The others follow in the order of their names.
    """
    usual = [name for name in USUAL_TEMPERATURES if name in temperatures]
    others = sorted(set(temperatures) - set(USUAL_TEMPERATURES))
    counts = [round(1000.0 * temperatures[name]) for name in (*usual, *others)][:TEMPERATURE_SLOTS]
    return counts + [NO_TEMPERATURE] * (TEMPERATURE_SLOTS - len(counts))


def _block_of(address: int, count: int) -> RegisterBlock:
    for block in BLOCKS:
        if block.holds(address, count):
            return block
    raise RegisterAccessError(ModbusExceptionCode.ILLEGAL_ADDRESS)
