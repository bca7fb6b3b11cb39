"""Kinds of fault by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from numpy.random import Generator

from campaigns.faults import (
    cell_faults,
    computer_faults,
    controller_faults,
    proxy_faults,
    thermometer_faults,
    wire_faults,
)
from campaigns.faults.fault_scene import FaultScene

CONTROLLER, CELL, COMPUTER, WIRE = "controller", "cell", "computer", "wire"
KILLED = "killed"
"""Name of the end of a run whose process is killed, which is not a fault of this table (`campaigns.crash_points`)."""


@dataclass(frozen=True)
class FaultKind:
    """Kind of fault. `apply` lets it begin now, with a size drawn by the generator. `reasons` are words of which the
    reason of a run that ends because of it must contain one. If `of_evening` is True, the fault usually is there from
    the beginning. `link` is the kind of real link that it disturbs, or empty. If `cleared` is True, a run that has
    ended because of it can be resumed once it is removed, and then ends as if it had not been there.
    """

    group: str
    apply: Callable[[FaultScene, Generator], None]
    reasons: tuple[str, ...]
    of_evening: bool = False
    link: str = ""
    cleared: bool = False


_LINK = tuple(text for _, text in wire_faults.ERRORS)
_REAL_LINKS = {
    "TCP": ("link modbus-tcp", "heartbeat"),
    "RTU": ("link modbus-rtu", "heartbeat"),
    "CAN": ("link slcan:", "link socketcand:", "drive", "heartbeat"),
}
"""Words by which a driver names its real link, or the controller its loss."""
KINDS: dict[str, FaultKind] = {
    "busy": FaultKind(CONTROLLER, controller_faults.busy, ("the controller is busy",)),
    "emergency stop": FaultKind(CONTROLLER, controller_faults.emergency_stop, ("emergency stop",), cleared=True),
    "door": FaultKind(CONTROLLER, controller_faults.door, ("door",), cleared=True),
    "wrong bank": FaultKind(CONTROLLER, controller_faults.wrong_bank, ()),
    "activation without effect": FaultKind(CONTROLLER, controller_faults.no_effect, ()),
    "flipped bit": FaultKind(CONTROLLER, controller_faults.flipped_bit, ()),
    "reversed sign": FaultKind(CONTROLLER, controller_faults.reversed_sign, ()),
    "wrong unit": FaultKind(CONTROLLER, controller_faults.wrong_unit, ()),
    "refused table": FaultKind(CONTROLLER, controller_faults.refused_table, ("the store refuses",)),
    "stale latch": FaultKind(CONTROLLER, controller_faults.stale_latch, ()),
    "stops short": FaultKind(CONTROLLER, controller_faults.stops_short, ("ended off its target",), cleared=True),
    "mount turned": FaultKind(CELL, cell_faults.mount_off, (), of_evening=True),
    "mount knocked": FaultKind(CELL, cell_faults.mount_knocked, ()),
    "bar reversed": FaultKind(CELL, cell_faults.bar_reversed, (), of_evening=True),
    "ball missing": FaultKind(CELL, cell_faults.ball_missing, (), of_evening=True),
    "ball exchanged": FaultKind(CELL, cell_faults.ball_exchanged, (), of_evening=True),
    "wrong bar": FaultKind(CELL, cell_faults.wrong_bar, (), of_evening=True),
    "inches": FaultKind(CELL, cell_faults.inches, (), of_evening=True),
    "thermometer wrong": FaultKind(CELL, thermometer_faults.wrong, ()),
    "thermometer stuck": FaultKind(CELL, thermometer_faults.stuck, ()),
    "thermometer unit": FaultKind(CELL, thermometer_faults.wrong_unit, ("the artefact",), of_evening=True),
    "thermometer jumps": FaultKind(CELL, thermometer_faults.jumps, ("the artefact",)),
    "thermometer drifts": FaultKind(CELL, thermometer_faults.drifts, ()),
    "thermometer lost": FaultKind(
        CELL, thermometer_faults.lost, ("the artefact", thermometer_faults.SILENT), cleared=True
    ),
    "probe battery": FaultKind(CELL, cell_faults.probe_battery, ("probe",)),
    "disk full": FaultKind(COMPUTER, computer_faults.disk_full, ("the journal cannot be written",), cleared=True),
    "read-only": FaultKind(COMPUTER, computer_faults.read_only, ("the journal cannot be written",), cleared=True),
    "calendar jumps": FaultKind(COMPUTER, computer_faults.calendar_jumps, ()),
    "starved": FaultKind(COMPUTER, computer_faults.starved, ()),
    "abort": FaultKind(COMPUTER, computer_faults.abort, (computer_faults.ABORT_REASON,)),
    "interruption": FaultKind(COMPUTER, computer_faults.interruption, ("SIGTERM",), cleared=True),
    "hold": FaultKind(COMPUTER, computer_faults.hold, (computer_faults.ABORT_REASON,)),
    "lost link": FaultKind(WIRE, wire_faults.lost_link, _LINK, cleared=True),
    "interrupted link": FaultKind(WIRE, wire_faults.interrupted_link, (*_LINK, "heartbeat"), cleared=True),
    "lost call": FaultKind(WIRE, wire_faults.lost_call, _LINK, cleared=True),
    "lost answer": FaultKind(WIRE, wire_faults.lost_answer, _LINK, cleared=True),
    **{
        f"{link} {name}": FaultKind(WIRE, apply, words, link=link, cleared=True)
        for link, words in _REAL_LINKS.items()
        for name, apply in proxy_faults.FAULTS.items()
    },
}
