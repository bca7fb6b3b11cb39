"""The roles a device plays. A driver implements one or more of them; nobody above knows which driver it is.

Units: mm, mm/s, s, °C; mount angles in degrees. Axis positions are the ones the controller displays, in the
order X, Y, Z. Every method may raise `DeviceError`; every wait has a deadline inside the driver and sleeps on
the clock the driver was given. When a wait is left by an exception of any kind, the driver stops the motion
it had started before the exception travels on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
"""Shape (3,), mm: X, Y, Z."""


@dataclass(frozen=True)
class AxisLimits:
    """Travel and dynamics of the three axes as the controller states them."""

    lower_mm: tuple[float, float, float]
    upper_mm: tuple[float, float, float]
    rapid_mm_per_s: tuple[float, float, float]
    acceleration_mm_per_s2: tuple[float, float, float]


class Permission(Enum):
    """What must be so before the agent may move; ISO 16090-1 operating conditions in the controller's words."""

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
    """A trip. `position_mm` is what the controller latched at the trip, never where it stopped."""

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Miss:
    """The target was reached and nothing tripped: a result, not a fault."""

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Orientation:
    azimuth_deg: float
    elevation_deg: float


class Activation(Enum):
    """When an activated bank takes effect."""

    IMMEDIATE = "immediate"
    RESET = "reset"
    POWER_CYCLE = "power_cycle"
    REFERENCE = "reference"


@dataclass(frozen=True)
class TableImage:
    """A compensation table as a controller holds it: corrections added to the commanded position.

    `counts` has shape (nx, ny, nz, 3), int32, x slowest; one count is `resolution_mm`. The grid is
    `origin_mm + index * step_mm`, along the axis positions displayed.
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
    """What a compensation store can represent."""

    banks: tuple[int, ...]
    max_nodes: tuple[int, int, int]
    max_total_nodes: int
    resolution_mm: float
    max_correction_mm: float
    activation: Activation


@runtime_checkable
class Machine(Protocol):
    """Three linear axes under a controller."""

    def limits(self) -> AxisLimits: ...

    def status(self) -> MachineStatus: ...

    def position(self) -> Vector: ...

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        """Straight line to `target_mm`; `None` is rapid. A guarded move that trips the probe stops and
        raises `GuardTripped`, its fault cleared, so that the way back out is open. Returns when the axes are in
        position."""

    def hold(self) -> None: ...

    def resume(self) -> None: ...

    def reset(self) -> None:
        """Clear a fault whose cause is gone; moves nothing, and does nothing where there is no fault.
        Raises CommandRejected while the cause lasts."""

    def stop(self) -> None:
        """Stop motion now; idempotent, and safe to call in any state."""


@runtime_checkable
class StepTracing(Protocol):
    """A device that passes on which step of a procedure its motions belong to, for the controller's own log."""

    def trace(self, tag: int) -> None:
        """The motions from now on belong to the step of this tag (32 bits, not 0)."""
        ...


@runtime_checkable
class Probe(Protocol):
    """A touch-trigger probe in the spindle."""

    def probe_status(self) -> ProbeStatus: ...

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        """Straight line towards `target_mm` until the probe trips; stops, and returns the latched position."""


@runtime_checkable
class RotaryMount(Protocol):
    """Azimuth about Z from +X, elevation from the XY plane."""

    def home(self) -> None: ...

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        """Turn, wait until both axes are in position and settled, return what the encoders say."""

    def orientation(self) -> Orientation: ...

    def stop(self) -> None: ...


@runtime_checkable
class MultiStationMount(Protocol):
    """A device with a mount at each of several stations behind it (counted from 1)."""

    def mount_at(self, station: int) -> RotaryMount: ...


@runtime_checkable
class CompensationStore(Protocol):
    """Banks of compensation tables in the controller; bank 0 is "no compensation" and cannot be written."""

    def store_limits(self) -> StoreLimits: ...

    def active_bank(self) -> int: ...

    def pending_bank(self) -> int | None:
        """The bank that will act once the controller has been reset, restarted or referenced; None: none waits."""
        ...

    def read_table(self, bank: int) -> TableImage | None:
        """The whole table, its CRC-32 proved; None where the bank is empty."""

    def stage(self, bank: int, table: TableImage) -> None:
        """Write into an inactive bank, commit with CRC-32. The active bank is refused."""

    def activate(self, bank: int) -> None:
        """Two steps: arm, then confirm; returns when the controller says that `bank` is active."""


@runtime_checkable
class Thermometer(Protocol):
    def temperatures_c(self) -> Mapping[str, float]:
        """Named temperatures: at least ``artefact``; usually ``ambient`` and ``machine`` too."""


class OperatorTask(Enum):
    """What a person at the machine can be asked for."""

    MOVE_ARTEFACT = "move the artefact and its mount to a station"
    CONSENT = "consent"


@dataclass(frozen=True)
class OperatorRequest:
    """A question with one answer: done / yes, or no. `station` counts from 1 where the task needs one."""

    task: OperatorTask
    text: str
    station: int | None = None


@runtime_checkable
class Operator(Protocol):
    """The person at the machine, by whatever they are reached: a console, a panel, a simulated hand."""

    def ask(self, request: OperatorRequest) -> bool: ...


@dataclass(frozen=True)
class DiagnosticFinding:
    """One line of a device's self-diagnosis (`volcal doctor`)."""

    subject: str
    ok: bool
    text: str


class Device(Protocol):
    """What every plugin creates, whatever roles it plays besides."""

    def open(self) -> None:
        """Connect and prove that the peer is the right one; moves nothing."""

    def close(self) -> None: ...

    def stop(self) -> None: ...

    def diagnose(self) -> list[DiagnosticFinding]:
        """Reach, read, measure latency; moves nothing and writes nothing."""
