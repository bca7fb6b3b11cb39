"""Kinds of fault by name, and the choice of kind, instant and size for a night."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from campaigns.faults import cell_faults, computer_faults, controller_faults, proxy_faults, wire_faults
from campaigns.faults.fault_scene import FaultScene

CONTROLLER, CELL, COMPUTER, WIRE = "controller", "cell", "computer", "wire"
PUBLISHING = ("before/active-table", "publish/stage", "publish/read-back", "activate/activate", "activate/active-bank")
"""Keys of the steps that read, write or activate tables; they take no machine time, so that no drawn instant of time
meets them."""
PUBLISHING_SHARE = 0.3
START_SHARE = 0.6
"""Share of the nights whose fault is there from the beginning, among the faults that a person makes before it."""


@dataclass(frozen=True)
class FaultKind:
    """Kind of fault. `apply` lets it begin now, with a size drawn by the generator. `reasons` are words of which the
    reason of a run that ends because of it must contain one. If `of_evening` is True, the fault usually is there from
    the beginning. If `proxied` is True, it disturbs a real link."""

    group: str
    apply: Callable[[FaultScene, Generator], None]
    reasons: tuple[str, ...]
    of_evening: bool = False
    proxied: bool = False


_LINK = tuple(text for _, text in wire_faults.ERRORS)
_TCP = ("link modbus-tcp", "heartbeat")
KINDS: dict[str, FaultKind] = {
    "busy": FaultKind(CONTROLLER, controller_faults.busy, ("the controller is busy",)),
    "emergency stop": FaultKind(CONTROLLER, controller_faults.emergency_stop, ("emergency stop",)),
    "door": FaultKind(CONTROLLER, controller_faults.door, ("door",)),
    "wrong bank": FaultKind(CONTROLLER, controller_faults.wrong_bank, ()),
    "activation without effect": FaultKind(CONTROLLER, controller_faults.no_effect, ()),
    "flipped bit": FaultKind(CONTROLLER, controller_faults.flipped_bit, ()),
    "reversed sign": FaultKind(CONTROLLER, controller_faults.reversed_sign, ()),
    "wrong unit": FaultKind(CONTROLLER, controller_faults.wrong_unit, ()),
    "refused table": FaultKind(CONTROLLER, controller_faults.refused_table, ("the store refuses",)),
    "stale latch": FaultKind(CONTROLLER, controller_faults.stale_latch, ()),
    "stops short": FaultKind(CONTROLLER, controller_faults.stops_short, ("ended off its target",)),
    "mount turned": FaultKind(CELL, cell_faults.mount_off, (), of_evening=True),
    "mount knocked": FaultKind(CELL, cell_faults.mount_knocked, ()),
    "bar reversed": FaultKind(CELL, cell_faults.bar_reversed, (), of_evening=True),
    "ball missing": FaultKind(CELL, cell_faults.ball_missing, (), of_evening=True),
    "ball exchanged": FaultKind(CELL, cell_faults.ball_exchanged, (), of_evening=True),
    "wrong bar": FaultKind(CELL, cell_faults.wrong_bar, (), of_evening=True),
    "inches": FaultKind(CELL, cell_faults.inches, (), of_evening=True),
    "thermometer stuck": FaultKind(CELL, cell_faults.thermometer_stuck, ()),
    "probe battery": FaultKind(CELL, cell_faults.probe_battery, ("probe",)),
    "disk full": FaultKind(COMPUTER, computer_faults.disk_full, ("the journal cannot be written",)),
    "read-only": FaultKind(COMPUTER, computer_faults.read_only, ("the journal cannot be written",)),
    "calendar jumps": FaultKind(COMPUTER, computer_faults.calendar_jumps, ()),
    "starved": FaultKind(COMPUTER, computer_faults.starved, ()),
    "abort": FaultKind(COMPUTER, computer_faults.abort, (computer_faults.ABORT_REASON,)),
    "interruption": FaultKind(COMPUTER, computer_faults.interruption, ("SIGTERM",)),
    "hold": FaultKind(COMPUTER, computer_faults.hold, (computer_faults.ABORT_REASON,)),
    "lost link": FaultKind(WIRE, wire_faults.lost_link, _LINK),
    "interrupted link": FaultKind(WIRE, wire_faults.interrupted_link, (*_LINK, "heartbeat")),
    "lost call": FaultKind(WIRE, wire_faults.lost_call, _LINK),
    "lost answer": FaultKind(WIRE, wire_faults.lost_answer, _LINK),
    "TCP delayed": FaultKind(WIRE, proxy_faults.delayed_frames, _TCP, proxied=True),
    "TCP lost": FaultKind(WIRE, proxy_faults.lost_frames, _TCP, proxied=True),
    "TCP repeated": FaultKind(WIRE, proxy_faults.repeated_frames, _TCP, proxied=True),
    "TCP reordered": FaultKind(WIRE, proxy_faults.reordered_frames, _TCP, proxied=True),
    "TCP garbled": FaultKind(WIRE, proxy_faults.garbled_frames, _TCP, proxied=True),
    "TCP cut": FaultKind(WIRE, proxy_faults.cut_connection, _TCP, proxied=True),
    "TCP stuck": FaultKind(WIRE, proxy_faults.stuck_connection, _TCP, proxied=True),
}
PROXIED_EVERY = 25
"""One night in so many has a real link; it takes several times as long as the others."""


@dataclass(frozen=True)
class PlannedFault:
    """Fault of one night. It begins at the fraction `fraction` of the machine time of an undisturbed night or, if `key`
    is not empty, at the step with this key: before it, or if `after` is True after its effect. `seed` and `night` are
    the numbers from which everything is drawn."""

    seed: int
    night: int
    kind: str
    fraction: float
    key: str = ""
    after: bool = False

    def generator(self) -> Generator:
        """Return the generator of the size of the fault."""
        return np.random.default_rng([self.seed, self.night, 1])


def plan_fault(seed: int, night: int) -> PlannedFault:
    """Return the fault of the night number `night` of the campaign with this seed.

    All kinds occur equally often: each of successive nights has another one, in an order drawn for each round.
    """
    proxied = night % PROXIED_EVERY == PROXIED_EVERY - 1
    names = [name for name, kind in KINDS.items() if kind.proxied is proxied]
    count = night // PROXIED_EVERY if proxied else night - night // PROXIED_EVERY
    order = np.random.default_rng([seed, count // len(names), 2]).permutation(len(names))
    kind = names[order[count % len(names)]]
    rng = np.random.default_rng([seed, night, 0])
    if KINDS[kind].of_evening and rng.random() < START_SHARE:
        return PlannedFault(seed, night, kind, 0.0)
    if rng.random() < PUBLISHING_SHARE:
        return PlannedFault(seed, night, kind, 1.0, str(rng.choice(PUBLISHING)), bool(rng.integers(2)))
    return PlannedFault(seed, night, kind, float(rng.random()))
