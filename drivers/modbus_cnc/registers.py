"""Register blocks of docs/reference/modbus-register-map.md as typed values.

Each field stands for one name in the tables of this document.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from typing import NamedTuple

from drivers.errors import ProtocolError
from drivers.modbus_cnc.codec import NumberFormat, RegisterField, RegisterLayout, WordOrder
from drivers.modbus_cnc.codes import MAJOR_VERSION, PERMISSION_BITS, PROTOCOL, STATES, BankState, MotionOutcome
from drivers.roles import MotionState, Permission

Triple = tuple[float, float, float]


class StatusImage(NamedTuple):
    """Contents of the controller's status block. Positions are in mm, and temperatures are in units of 0.001 °C."""

    protocol: int
    version: int
    heartbeat: int
    heartbeat_echo: int
    state_code: int
    fault_code: int
    permission_bits: int
    probe_bits: int
    acknowledge: int
    result: int
    motion_sequence: int
    motion_outcome: int
    position: Triple
    latch_sequence: int
    latch_result: int
    latched: Triple
    active_bank: int
    staged_bank: int
    open_bank: int
    armed_bank: int
    armed_nonce: int
    pending_bank: int
    block_acknowledge: int
    block_result: int
    bank_states: tuple[int, int]
    bank_crcs: tuple[int, int]
    temperature_count: int
    temperatures: tuple[int, ...]
    heartbeat_copy: int

    @property
    def is_consistent(self) -> bool:
        """True if both copies of the heartbeat counter in the status image agree. They differ if the controller wrote
        the image during the read.
        """
        return self.heartbeat == self.heartbeat_copy

    @property
    def state(self) -> MotionState:
        return STATES[self.state_code]

    @property
    def outcome(self) -> MotionOutcome:
        return MotionOutcome(self.motion_outcome)

    @property
    def permissions(self) -> dict[Permission, bool]:
        return {name: bool(self.permission_bits >> bit & 1) for bit, name in enumerate(PERMISSION_BITS)}

    def bank_state(self, bank: int) -> BankState:
        """Return the state of `bank`, which is 1 or 2."""
        return BankState(self.bank_states[bank - 1])


class ControllerLimits(NamedTuple):
    """Limits of axis travel, speed, acceleration and compensation tables, as reported by the controller in mm, mm/s and
    mm/s².
    """

    lower: Triple
    upper: Triple
    rapid: Triple
    acceleration: Triple
    banks: int
    max_nodes: tuple[int, int, int]
    max_total_nodes: int
    resolution: float
    max_correction: float
    activation: int


class CommandBlock(NamedTuple):
    """Contents of the command block, except the heartbeat and the sequence number. `ModbusSession` adds these two."""

    code: int
    bank: int = 0
    nonce: int = 0
    crc: int = 0
    target: Triple = (0.0, 0.0, 0.0)
    feed: float = 0.0


class TableDescriptor(NamedTuple):
    """Descriptor of a compensation table in the controller.

    It contains the bank, the grid in mm, the correction in mm that one count stands for, and the CRC-32 of the counts.
    """

    bank: int
    nodes: tuple[int, int, int]
    origin: Triple
    step: Triple
    resolution: float
    crc: int


_LAST_OUTCOME = max(MotionOutcome)


class BlockLayouts:
    """Layouts of all register blocks of the Modbus register map for one number format."""

    def __init__(self, numbers: NumberFormat) -> None:
        self.numbers = numbers
        self.status = RegisterLayout(_STATUS, numbers)
        self.limits = RegisterLayout(_LIMITS, numbers)
        self.command = RegisterLayout(_COMMAND, numbers)
        self.descriptor = RegisterLayout(_DESCRIPTOR, numbers)
        self.block = RegisterLayout([RegisterField("counts", "i32", 60)], numbers)

    def decode_status(self, data: bytes, where: Mapping[str, str], first_register: int) -> StatusImage:
        """Decode the contents of the status block. Raises ProtocolError if a register has a value that the register map
        does not allow.

        The error states the address of this register.
        """
        status = StatusImage(*self.status.unpack(data))
        # The upper byte of the version is the major version.
        if status.protocol != PROTOCOL or status.version >> 8 != MAJOR_VERSION:
            raise ProtocolError(
                f"no volcal register map found: protocol {status.protocol:#06x}, version {status.version:#06x}",
                hint=f"expected {PROTOCOL:#06x} and {MAJOR_VERSION:#04x}xx; check address, unit, word order",
                register=first_register,
                **where,
            )
        # The image was written while it was read. The caller reads again, so nothing in it is judged.
        if not status.is_consistent:
            return status
        wrong = _first_illegal(status)
        if wrong:
            value = getattr(status, wrong)
            raise ProtocolError(
                f"the controller shows an illegal {wrong.replace('_', ' ')}: {value}{self._other_order(value)}",
                hint="compare number type, word order and addresses in the configuration with the controller",
                register=first_register + self.status.offset(wrong),
                **where,
            )
        return status

    def _other_order(self, value: object) -> str:
        """Return a text that names the order of words and bytes in which a position would be plausible; empty if there
        is none, or if the value is no position."""
        if not isinstance(value, tuple) or self.numbers.kind != "float64" or not isinstance(value[0], float):
            return ""
        orders: tuple[WordOrder, ...] = ("high-first", "low-first")
        for words, in_word in itertools.product(orders, orders):
            numbers = dataclasses.replace(self.numbers, word_order=words, byte_order=in_word)
            field = [RegisterField("position", "number", 3)]
            (read,) = RegisterLayout(field, numbers).unpack(RegisterLayout(field, self.numbers).pack([value]))
            if all(map(_is_plausible, read)) and any(read):
                shown = ", ".join(f"{one:.3f}" for one in read)
                return (
                    f"; it would be {shown} mm with word_order {words!r} and byte_order {in_word!r}: the controller "
                    "orders the registers of this value in another way than configured"
                )
        return ""


LARGEST_POSITION_MM, SMALLEST_POSITION_MM = 1e6, 1e-30
"""Bounds of the absolute value of a position other than zero. A float64 with its words or bytes in a wrong order is
larger than 1e50 or smaller than 1e-50 in most cases."""


def _is_plausible(value_mm: float) -> bool:
    return value_mm == 0.0 or SMALLEST_POSITION_MM <= abs(value_mm) <= LARGEST_POSITION_MM


def _first_illegal(status: StatusImage) -> str:
    if status.state_code not in STATES:
        return "state_code"
    if status.motion_outcome > _LAST_OUTCOME:
        return "motion_outcome"
    if not all(map(_is_plausible, status.position)):
        return "position"
    if not all(map(_is_plausible, status.latched)):
        return "latched"
    # The codes count from 0 without gaps.
    if max(status.bank_states) > BankState.DAMAGED:
        return "bank_states"
    return "" if status.temperature_count <= len(status.temperatures) else "temperature_count"


_STATUS = (
    *(RegisterField(name, "u16") for name in StatusImage._fields[:12]),
    RegisterField("position", "number", 3),
    RegisterField("latch_sequence", "u16"),
    RegisterField("latch_result", "u16"),
    RegisterField("latched", "number", 3),
    *(RegisterField(name, "u16") for name in StatusImage._fields[16:24]),
    RegisterField("bank_states", "u16", 2),
    RegisterField("bank_crcs", "u32", 2),
    RegisterField("temperature_count", "u16"),
    RegisterField("temperatures", "i32", 8),
    RegisterField("heartbeat_copy", "u16"),
)

_LIMITS = (
    RegisterField("lower", "number", 3),
    RegisterField("upper", "number", 3),
    RegisterField("rapid", "number", 3),
    RegisterField("acceleration", "number", 3),
    RegisterField("banks", "u16"),
    RegisterField("max_nodes", "u16", 3),
    RegisterField("max_total_nodes", "u32"),
    RegisterField("resolution", "number"),
    RegisterField("max_correction", "number"),
    RegisterField("activation", "u16"),
)

_COMMAND = (
    RegisterField("heartbeat", "u16"),
    RegisterField("code", "u16"),
    RegisterField("bank", "u16"),
    RegisterField("nonce", "u16"),
    RegisterField("crc", "u32"),
    RegisterField("target", "number", 3),
    RegisterField("feed", "number"),
    RegisterField("sequence", "u16"),
)

_DESCRIPTOR = (
    RegisterField("bank", "u16"),
    RegisterField("nodes", "u16", 3),
    RegisterField("origin", "number", 3),
    RegisterField("step", "number", 3),
    RegisterField("resolution", "number"),
    RegisterField("crc", "u32"),
)
