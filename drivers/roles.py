"""Device roles. A device implements one or more of them, and its callers depend only on the roles.

Lengths are in mm, speeds in mm/s, times in s, temperatures in °C, and mount angles in degrees. Axis positions are those
that the controller displays, in the order X, Y, Z. Every method may raise `DeviceError`. Every wait has a deadline
inside the driver and sleeps on the clock passed to the driver. If an exception of any kind ends a wait, the driver
first stops the motion that it started, and only then lets the exception propagate.
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
    """Travel and dynamics of the three axes, as reported by the controller; NaN where it does not report a value."""

    lower_mm: tuple[float, float, float]
    upper_mm: tuple[float, float, float]
    rapid_mm_per_s: tuple[float, float, float]
    acceleration_mm_per_s2: tuple[float, float, float]


class Permission(Enum):
    """Conditions that must be met before the machine may move (operating conditions of ISO 16090-1).

    The value of each member is the text that names the condition in messages.
    """

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
    """Result of a touch that ended with a trip.

    `position_mm` is the position latched at the trip, not the position at which the axes stopped.
    """

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Miss:
    """Result of a touch that reached its target without a trip.

    A miss is not a fault.
    """

    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Orientation:
    azimuth_deg: float
    elevation_deg: float


class Activation(Enum):
    """Event at which the compensation table of an activated bank takes effect."""

    IMMEDIATE = "immediate"
    RESET = "reset"
    POWER_CYCLE = "power_cycle"
    REFERENCE = "reference"


@dataclass(frozen=True)
class TableImage:
    """Compensation table as stored in a controller: corrections added to the commanded position.

    `counts` is an int32 array of shape (nx, ny, nz, 3): the numbers of grid nodes along x, y and z, and the three
    components of a correction. One count is `resolution_mm`. The grid nodes are at `origin_mm + index * step_mm`, in
    displayed axis positions.
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
    """Limits on the tables that a compensation store accepts.

    `own_axis_loss_mm` is None if the controller applies whole tables. Otherwise, it corrects each axis by the position
    of this axis alone, and `own_axis_loss_mm` is the largest part of a correction that may be lost at any node.
    """

    banks: tuple[int, ...]
    max_nodes: tuple[int, int, int]
    max_total_nodes: int
    resolution_mm: float
    max_correction_mm: float
    activation: Activation
    own_axis_loss_mm: float | None = None


@runtime_checkable
class Machine(Protocol):
    """Machine with three linear axes under a controller."""

    def limits(self) -> AxisLimits: ...

    def status(self) -> MachineStatus: ...

    def position(self) -> Vector: ...

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        """Move in a straight line to `target_mm` and return when the axes are in position.

        A feed of None means rapid traverse. If the probe trips in a guarded move (`guarded` is True), the axes stop.
        The method then clears the resulting fault of the controller and raises `GuardTripped`, and the probe can be
        withdrawn at once.
        """

    def hold(self) -> None: ...

    def resume(self) -> None:
        """Continue a held motion.

        Controllers ignore the command while the axes still brake for the hold, so the caller first waits until `status`
        shows that they stand. Like `hold`, both are called from inside a sleep of the clock.
        """

    def reset(self) -> None:
        """Clear a fault whose cause has been removed, without moving an axis. Does nothing if there is no fault.

        Raises CommandRejected if the cause persists.
        """

    def stop(self) -> None:
        """Stop all motion at once. The call is safe in any state and may be repeated."""


HomingDirections = tuple[int, int, int]


@runtime_checkable
class AxisHoming(Protocol):
    """Machine that can be asked whether its controller homes the axes on command, and can be commanded to do so."""

    def why_no_homing(self) -> str:
        """Return the reason why the axes cannot be homed on command, in words; an empty text if they can. Moves
        nothing."""
        ...

    def homing_directions(self) -> HomingDirections:
        """Return the direction in which X, Y and Z search their switches: 1 towards the upper end of travel, -1 towards
        the lower end, 0 if the axis searches none."""
        ...

    def home_axes(self) -> None:
        """Home all axes in the sequence of the controller, also those that are homed already, and return when they are
        at rest and homed. The axes travel to their switches or marks on paths that the controller chooses.

        Raises CommandRejected if the axes cannot be homed, and MotionFault if homing has failed; the axes then count as
        not referenced.
        """


@runtime_checkable
class StepTracing(Protocol):
    """Device that tells the controller to which step of the measuring procedure each motion belongs.

    The controller can then write the step to its own log.
    """

    def trace(self, tag: int) -> None:
        """Assign all further motions to the step with the number `tag`, which has 32 bits and is not 0."""
        ...


@runtime_checkable
class RestorableLink(Protocol):
    """Device that restores its link after an interruption while nothing moves, and counts the interruptions."""

    def interruptions(self) -> int:
        """Return the number of interruptions of the link from which the device has recovered since it was created."""
        ...


@runtime_checkable
class LookOnlyDevice(Protocol):
    """Device that can be read without any effect on the connected equipment, unless it gives a reason why not.

    Nothing moves, and no fault, alarm, lock, mode or message of the equipment changes.
    """

    def why_no_look(self) -> str:
        """Return the reason why the equipment cannot be read without an effect, in words; an empty text if it can.
        Sends nothing."""
        ...

    def open_to_look(self, *, tables: bool = False) -> None:
        """Connect and verify that the equipment answers, but write nothing. Until the device is closed, it refuses
        whatever would write to the equipment, and `stop` does nothing.

        The active and the pending bank can be read, and with `tables` also the tables in the banks. A controller that
        shows a table only block by block is then told which block to show, and nothing else. Raises CommandRejected
        if `why_no_look` gives a reason.
        """
        ...

    def close(self) -> None: ...


@runtime_checkable
class ImpairableDevice(Protocol):
    """Device that still works although a part of its monitoring is impaired, and says so."""

    def impairments(self) -> list[str]:
        """Return what is impaired at present, one text for each; an empty list if nothing is. Sends nothing."""
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
        """Turn to the given angles, wait until both axes are in position and settled, and return the encoder angles."""

    def orientation(self) -> Orientation: ...

    def stop(self) -> None: ...


@runtime_checkable
class HoldableMount(Protocol):
    """Rotary mount whose turn can be held and continued.

    Both methods are called from inside a sleep of the clock, and do nothing if no turn is in progress.
    """

    def hold_turn(self) -> None: ...

    def resume_turn(self) -> None: ...


@runtime_checkable
class MultiStationMount(Protocol):
    """Device that serves one mount at each of several stations, the places of a mount along the machine's long axis
    (counted from 1).
    """

    def mount_at(self, station: int) -> RotaryMount: ...


@runtime_checkable
class CompensationStore(Protocol):
    """Banks of compensation tables in the controller; bank 0 means "no compensation" and cannot be written."""

    def store_limits(self) -> StoreLimits: ...

    def active_bank(self) -> int: ...

    def pending_bank(self) -> int | None:
        """Return the bank that becomes active at the next reset, restart or referencing of the controller; None if no
        bank is pending.
        """
        ...

    def read_table(self, bank: int) -> TableImage | None:
        """Return the whole table of `bank` after checking its CRC-32, or None if the bank is empty."""

    def stage(self, bank: int, table: TableImage) -> None:
        """Write a table to an inactive bank and commit it with its CRC-32. Raises StoreError if the bank is active."""

    def activate(self, bank: int) -> None:
        """Activate `bank` in two steps, arm and confirm. Returns once the controller reports the bank as active."""


@runtime_checkable
class Thermometer(Protocol):
    def temperatures_c(self) -> Mapping[str, float]:
        """Return temperatures in °C by name: at least ``artefact``, usually also ``ambient`` and ``machine``."""


class OperatorTask(Enum):
    """Tasks that an operator can be asked to do."""

    MOVE_ARTEFACT = "move the artefact and its mount to a station"
    PLACE_ARTEFACT = "place the artefact by hand in a position"
    CONSENT = "consent"


@dataclass(frozen=True)
class OperatorRequest:
    """Question to the operator, to be answered with yes or no. "Done" counts as yes.

    `station` is the number of the station that the task concerns, counted from 1, or None if the task concerns no
    station.
    """

    task: OperatorTask
    text: str
    station: int | None = None


@dataclass(frozen=True)
class BallPlace:
    """Axis positions in mm, as the controller displays them, at which the stylus tip is at the centre of the ball
    number `ball`, counted from 0."""

    ball: int
    position_mm: tuple[float, float, float]


@dataclass(frozen=True)
class PlacementRequest(OperatorRequest):
    """Request to place the artefact by hand at `station` with the given azimuth and elevation.

    `balls` gives the places of some balls; the first of them is measured first. If an earlier attempt at the same
    position was refused, `refused` is the reason as a code (a value of
    `agent.probing.hand_placement.PlacementFault`), and `refused_ball` is the ball that it concerns. Otherwise `refused`
    is empty.
    """

    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    balls: tuple[BallPlace, ...] = ()
    refused: str = ""
    refused_ball: int | None = None


@runtime_checkable
class Operator(Protocol):
    """Person at the machine, who is reached through a console or a panel. A program may simulate this person."""

    def ask(self, request: OperatorRequest) -> bool: ...


@dataclass(frozen=True)
class DiagnosticFinding:
    """One result of a device's self-diagnosis (`volcal doctor`).

    `ok` is None if the device could not read the value that is to be judged.
    """

    subject: str
    ok: bool | None
    text: str


class Device(Protocol):
    """Interface that every device of a plugin has in addition to its roles."""

    def open(self) -> None:
        """Connect, and verify the identity of the connected equipment. Moves nothing."""

    def close(self) -> None: ...

    def stop(self) -> None: ...

    def diagnose(self) -> list[DiagnosticFinding]:
        """Check that the device answers, read its state and measure latency. Moves nothing and writes nothing."""
