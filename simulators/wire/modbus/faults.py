"""Fault codes of the register map (table 9.1) for the fault texts of the physics."""

from __future__ import annotations

from typing import Final

from simulators.wire.modbus.register_map import FaultCode, ModbusOutcome

WATCHED_FAULTS: Final = {
    FaultCode.HEARTBEAT_LOST: "agent heartbeat lost",
    FaultCode.DOOR_OPENED: "door opened while moving",
    FaultCode.PERMISSION_LOST: "permission lost while moving",
    FaultCode.PROBE_LOST: "probe lost while moving",
}
"""Faults that are detected here and not by the physics, with the texts passed to it."""

_FAULT_WORDS: Final = (
    ("collision", FaultCode.COLLISION),
    ("overload", FaultCode.COLLISION),
    ("probe tripped", FaultCode.PROBE_TRIPPED),
    ("emergency", FaultCode.EMERGENCY_STOP),
    ("travel", FaultCode.END_OF_TRAVEL),
    ("following", FaultCode.FOLLOWING_ERROR),
    ("drive", FaultCode.DRIVE),
    *((words, code) for code, words in WATCHED_FAULTS.items()),
)


def fault_code(fault: str) -> FaultCode:
    """Return the code of a fault text of the physics; 99 if the table has none for it."""
    words = fault.lower()
    for marker, code in _FAULT_WORDS:
        if marker in words:
            return code
    return FaultCode.OTHER


def outcome_of(fault: FaultCode) -> ModbusOutcome:
    """Return the outcome of a motion that ended in this fault (table 9.3)."""
    if fault is FaultCode.PROBE_TRIPPED:
        return ModbusOutcome.GUARD_TRIPPED
    return ModbusOutcome.HEARTBEAT_LOST if fault is FaultCode.HEARTBEAT_LOST else ModbusOutcome.FAULT
