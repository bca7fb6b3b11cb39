"""Fault codes (docs/reference/modbus-register-map.md, table 9.1) for the fault texts of the simulated machine."""

from __future__ import annotations

from typing import Final

from simulators.wire.modbus.register_map import FaultCode, ModbusOutcome

WATCHED_FAULTS: Final = {
    FaultCode.HEARTBEAT_LOST: "agent heartbeat lost",
    FaultCode.DOOR_OPENED: "door opened while moving",
    FaultCode.PERMISSION_LOST: "permission lost while moving",
    FaultCode.PROBE_LOST: "probe lost while moving",
}
"""Faults that the register side detects, not the simulated machine, and the texts with which it reports them to the
machine."""

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
    """Return the fault code of the Modbus register map for a fault text of the simulated machine, or 99 (other) if no
    code matches.
    """
    words = fault.lower()
    for marker, code in _FAULT_WORDS:
        if marker in words:
            return code
    return FaultCode.OTHER


def outcome_of(fault: FaultCode) -> ModbusOutcome:
    """Return the outcome of a motion that ended with the fault code `fault`.

    Fault codes and outcomes are those of docs/reference/modbus-register-map.md, tables 9.1 and 9.3.
    """
    if fault is FaultCode.PROBE_TRIPPED:
        return ModbusOutcome.GUARD_TRIPPED
    return ModbusOutcome.HEARTBEAT_LOST if fault is FaultCode.HEARTBEAT_LOST else ModbusOutcome.FAULT
