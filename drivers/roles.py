"""Device roles. A device implements one or more of them, and its callers depend only on the roles.

Units: mm, mm/s, s, °C; mount angles in degrees. Axis positions are the displayed ones, in the order X, Y, Z.
Every method may raise `DeviceError`. Every wait has a deadline inside the driver and sleeps on the clock passed to
the driver. If an exception of any kind ends a wait, the driver first stops the motion that it started, then propagates
the exception.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
"""Axis positions X, Y, Z, shape (3,), mm."""


@dataclass(frozen=True)
class AxisLimits:
    """Travel and dynamics of the three axes, as reported by the controller."""

    lower_mm: tuple[float, float, float]
    upper_mm: tuple[float, float, float]
    rapid_mm_per_s: tuple[float, float, float]
    acceleration_mm_per_s2: tuple[float, float, float]


class Permission(Enum):
    """Conditions for moving the machine (operating conditions of ISO 16090-1); values are the words for messages."""

    AUTOMATIC = "controller in automatic mode"
    DOORS_CLOSED = "doors closed"
    SPINDLE_STOPPED = "spindle stopped and oriented"
    PROGRAM_IDLE = "no part program running"
    REFERENCED = "axes referenced"
    NO_FAULT = "no fault or e-stop"
    CONSENT = "operator consent"


class MotionState(Enum):
    IDLE = "idle"
    MOVING = "moving"
    HELD = "held"
    FAULT = "fault"


@dataclass(frozen=True)
class MachineStatus:
    state: MotionState
    permissions: Mapping[Permission, bool]
    fault: str = ""

    @property
    def missing(self) -> tuple[Permission, ...]:
        return tuple(name for name, given in self.permissions.items() if not given)


@dataclass(frozen=True)
class ProbeStatus:
    loaded: bool
    healthy: bool
    deflected: bool
    detail: str = ""


@dataclass(frozen=True)
class Touch:
    """Result of a probe trip. `position_mm` is the position latched at the trip, not where the axes stopped."""

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Miss:
    """Probing move that reached its target without a trip: a result, not a fault."""

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Orientation:
    azimuth_deg: float
    elevation_deg: float


class Activation(Enum):
    """Event at which an activated bank takes effect."""

    IMMEDIATE = "immediate"
    RESET = "reset"
    POWER_CYCLE = "power_cycle"
    REFERENCE = "reference"


@dataclass(frozen=True)
class TableImage:
    """Compensation table as stored in a controller: corrections added to the commanded position.

    `counts` has shape (nx, ny, nz, 3), int32, x slowest; one count is `resolution_mm`. The grid nodes are at
    `origin_mm + index * step_mm`, in displayed axis positions.
    """

    origin_mm: tuple[float, float, float]
    step_mm: tuple[float, float, float]
    resolution_mm: float
    counts: NDArray[np.int32] = field(repr=False)

    @property
    def shape(self) -> tuple[int, int, int]:
        nx, ny, nz, _ = self.counts.shape
        return nx, ny, nz

    def same_as(self, other: TableImage) -> bool:
        return (
            self.origin_mm == other.origin_mm
            and self.step_mm == other.step_mm
            and self.resolution_mm == other.resolution_mm
            and np.array_equal(self.counts, other.counts)
        )


@dataclass(frozen=True)
class StoreLimits:
    """Limits on the tables that a compensation store accepts."""

    banks: tuple[int, ...]
    max_nodes: tuple[int, int, int]
    max_total_nodes: int
    resolution_mm: float
    max_correction_mm: float
    activation: Activation


@runtime_checkable
class Machine(Protocol):
    """Machine with three linear axes under a controller."""

    def limits(self) -> AxisLimits: ...

    def status(self) -> MachineStatus: ...

    def position(self) -> Vector: ...

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        """Move in a straight line to `target_mm` and return when the axes are in position.

        A feed of None means rapid traverse. If the probe trips in a guarded move, the axes stop, and the method clears
        the fault and raises `GuardTripped`, so the withdrawal can start at once.
        """

    def hold(self) -> None: ...

    def resume(self) -> None: ...

    def reset(self) -> None:
        """Clear a fault whose cause has been removed; does nothing if there is no fault. Moves nothing.

        Raises CommandRejected while the cause persists.
        """

    def stop(self) -> None:
        """Stop motion now; idempotent, and safe to call in any state."""


@runtime_checkable
class StepTracing(Protocol):
    """Device that reports to the controller's own log which step of the procedure a motion belongs to."""

    def trace(self, tag: int) -> None:
        """Assign all further motions to the step with this tag, a 32-bit number other than 0."""
        ...


@runtime_checkable
class Probe(Protocol):
    """Touch-trigger probe in the spindle."""

    def probe_status(self) -> ProbeStatus: ...

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        """Move in a straight line towards `target_mm` until the probe trips, stop, and return the latched position.

        Returns a `Miss` if the target is reached without a trip.
        """


@runtime_checkable
class RotaryMount(Protocol):
    """Rotary mount of the artefact.

    The azimuth is the angle about Z from +X, and the elevation is the angle from the XY plane.
    """

    def home(self) -> None: ...

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        """Turn, wait until both axes are in position and settled, and return the encoder angles."""

    def orientation(self) -> Orientation: ...

    def stop(self) -> None: ...


@runtime_checkable
class MultiStationMount(Protocol):
    """Device that serves one mount at each of several stations (counted from 1)."""

    def mount_at(self, station: int) -> RotaryMount: ...


@runtime_checkable
class CompensationStore(Protocol):
    """Banks of compensation tables in the controller; bank 0 means "no compensation" and cannot be written."""

    def store_limits(self) -> StoreLimits: ...

    def active_bank(self) -> int: ...

    def pending_bank(self) -> int | None:
        """Return the bank that becomes active at the next reset, restart or referencing; None if there is none."""
        ...

    def read_table(self, bank: int) -> TableImage | None:
        """Return the whole table after checking its CRC-32; None if the bank is empty."""

    def stage(self, bank: int, table: TableImage) -> None:
        """Write a table to an inactive bank and commit it with its CRC-32. Raises StoreError for the active bank."""

    def activate(self, bank: int) -> None:
        """Activate `bank` in two steps, arm and confirm; return once the controller reports it as active."""


@runtime_checkable
class Thermometer(Protocol):
    def temperatures_c(self) -> Mapping[str, float]:
        """Return temperatures in °C by name: at least ``artefact``, usually also ``ambient`` and ``machine``."""


class OperatorTask(Enum):
    """Tasks that an operator can be asked to do."""

    MOVE_ARTEFACT = "move the artefact and its mount to a station"
    CONSENT = "consent"


@dataclass(frozen=True)
class OperatorRequest:
    """Yes/no question to the operator; "done" counts as yes.

    `station` is the station that the task concerns, counted from 1; None if it concerns none.
    """

    task: OperatorTask
    text: str
    station: int | None = None


@runtime_checkable
class Operator(Protocol):
    """Person at the machine, reached through a console or a panel, or simulated."""

    def ask(self, request: OperatorRequest) -> bool: ...


@dataclass(frozen=True)
class DiagnosticFinding:
    """One result of a device's self-diagnosis (`volcal doctor`)."""

    subject: str
    ok: bool
    text: str


class Device(Protocol):
    """Interface of every device that a plugin creates, in addition to its roles."""

    def open(self) -> None:
        """Connect and verify the identity of the peer; moves nothing."""

    def close(self) -> None: ...

    def stop(self) -> None: ...

    def diagnose(self) -> list[DiagnosticFinding]:
        """Check that the device answers, read its state and measure latency. Moves nothing and writes nothing."""
