"""The blocks of the register map as typed values; each field is one name of the documented table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from drivers.errors import ProtocolError
from drivers.modbus_cnc.codec import Layout, NumberFormat, Register
from drivers.modbus_cnc.codes import MAJOR_VERSION, PERMISSION_BITS, PROTOCOL, STATES, BankState, Outcome
from drivers.roles import MotionState, Permission

Triple = tuple[float, float, float]


class Status(NamedTuple):
    """One status image. Positions in mm, temperatures in 0.001 °C."""

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
    def whole(self) -> bool:
        """False for an image that was read while the controller wrote it."""
        return self.heartbeat == self.heartbeat_copy

    @property
    def state(self) -> MotionState:
        return STATES[self.state_code]

    @property
    def outcome(self) -> Outcome:
        return Outcome(self.motion_outcome)

    @property
    def permissions(self) -> dict[Permission, bool]:
        return {name: bool(self.permission_bits >> bit & 1) for bit, name in enumerate(PERMISSION_BITS)}

    def bank_state(self, bank: int) -> BankState:
        """`bank` is 1 or 2."""
        return BankState(self.bank_states[bank - 1])


class Limits(NamedTuple):
    """What the controller says about its travel and its tables; mm, mm/s, mm/s²."""

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


class Command(NamedTuple):
    """A command block without heartbeat and sequence number, which belong to the session."""

    code: int
    bank: int = 0
    nonce: int = 0
    crc: int = 0
    target: Triple = (0.0, 0.0, 0.0)
    feed: float = 0.0


class Descriptor(NamedTuple):
    """What a table's counts mean; mm."""

    bank: int
    nodes: tuple[int, int, int]
    origin: Triple
    step: Triple
    resolution: float
    crc: int


_LAST_OUTCOME = max(Outcome)


class Layouts:
    """The layouts of all blocks for one number format."""

    def __init__(self, numbers: NumberFormat) -> None:
        self.status = Layout(_STATUS, numbers)
        self.limits = Layout(_LIMITS, numbers)
        self.command = Layout(_COMMAND, numbers)
        self.descriptor = Layout(_DESCRIPTOR, numbers)
        self.block = Layout([Register("counts", "i32", 60)], numbers)

    def decode_status(self, data: bytes, where: Mapping[str, str], first_register: int) -> Status:
        """Raises ProtocolError for values that the map does not allow, naming the register."""
        status = Status(*self.status.unpack(data))
        if status.protocol != PROTOCOL or status.version >> 8 != MAJOR_VERSION:
            raise ProtocolError(
                f"no volcal register map: protocol {status.protocol:#06x}, version {status.version:#06x}",
                hint=f"expected {PROTOCOL:#06x} and {MAJOR_VERSION:#04x}xx; check address, unit, word order",
                register=first_register,
                **where,
            )
        if not status.whole:
            return status
        wrong = _first_illegal(status)
        if wrong:
            raise ProtocolError(
                f"controller shows an illegal {wrong.replace('_', ' ')}: {getattr(status, wrong)}",
                hint="compare number type, word order and addresses in the configuration with the controller",
                register=first_register + self.status.offset(wrong),
                **where,
            )
        return status


def _first_illegal(status: Status) -> str:
    if status.state_code not in STATES:
        return "state_code"
    if status.motion_outcome > _LAST_OUTCOME:
        return "motion_outcome"
    if not all(map(math.isfinite, status.position)):
        return "position"
    if not all(map(math.isfinite, status.latched)):
        return "latched"
    if max(status.bank_states) > BankState.DAMAGED:
        return "bank_states"
    return "" if status.temperature_count <= len(status.temperatures) else "temperature_count"


_STATUS = (
    *(Register(name, "u16") for name in Status._fields[:12]),
    Register("position", "number", 3),
    Register("latch_sequence", "u16"),
    Register("latch_result", "u16"),
    Register("latched", "number", 3),
    *(Register(name, "u16") for name in Status._fields[16:24]),
    Register("bank_states", "u16", 2),
    Register("bank_crcs", "u32", 2),
    Register("temperature_count", "u16"),
    Register("temperatures", "i32", 8),
    Register("heartbeat_copy", "u16"),
)

_LIMITS = (
    Register("lower", "number", 3),
    Register("upper", "number", 3),
    Register("rapid", "number", 3),
    Register("acceleration", "number", 3),
    Register("banks", "u16"),
    Register("max_nodes", "u16", 3),
    Register("max_total_nodes", "u32"),
    Register("resolution", "number"),
    Register("max_correction", "number"),
    Register("activation", "u16"),
)

_COMMAND = (
    Register("heartbeat", "u16"),
    Register("code", "u16"),
    Register("bank", "u16"),
    Register("nonce", "u16"),
    Register("crc", "u32"),
    Register("target", "number", 3),
    Register("feed", "number"),
    Register("sequence", "u16"),
)

_DESCRIPTOR = (
    Register("bank", "u16"),
    Register("nodes", "u16", 3),
    Register("origin", "number", 3),
    Register("step", "number", 3),
    Register("resolution", "number"),
    Register("crc", "u32"),
)
