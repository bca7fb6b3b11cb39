"""What a plan can ask for. A step is a frozen value with a stable key; the engine has it done.

The key names the place in the procedure (``station-1/az090-el045/ball-03/touch-2``), is unique in a run and
the same whenever the plan is rebuilt from the same settings and the same results: a resumed run finds its way
by it. Positions are axis positions in mm as the controller displays them; plain tuples, so that a step can be
written to the journal as it stands.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from drivers.roles import OperatorRequest, TableImage

Point: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Straight line; rapid where no feed is given. Every move near the artefact is guarded."""

    key: str
    target_mm: Point
    feed_mm_per_s: float | None = None
    guarded: bool = True


@dataclass(frozen=True, slots=True)
class Retrace:
    """A guarded move that ends where and as the step `of` has ended: from the same side, its play taken up alike."""

    key: str
    target_mm: Point
    of: str
    feed_mm_per_s: float | None = None


@dataclass(frozen=True, slots=True)
class TouchTowards:
    """Result: `Touch` or `Miss`."""

    key: str
    target_mm: Point
    feed_mm_per_s: float


@dataclass(frozen=True, slots=True)
class HomeMount:
    key: str
    station: int


@dataclass(frozen=True, slots=True)
class OrientTo:
    """The mount at `station` turns. Result: the `Orientation` that its encoders report."""

    key: str
    station: int
    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class ReadTemperatures:
    """Result: mapping of names to °C."""

    key: str


@dataclass(frozen=True, slots=True)
class ReadClock:
    """Result: seconds of machine time on the clock of the run; one that is gone on with goes on from its last one."""

    key: str


@dataclass(frozen=True, slots=True)
class ReadPosition:
    """Result: the axis positions as a Point; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckPermissions:
    """Raises PermissionMissing where the controller does not permit motion."""

    key: str


@dataclass(frozen=True, slots=True)
class ResetFault:
    """Clear a fault of the controller whose cause is gone; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckProbe:
    """Raises MeasurementFault where the probe is not loaded, not healthy, or deflected."""

    key: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Raises Aborted where the answer is no."""

    key: str
    request: OperatorRequest


@dataclass(frozen=True, slots=True)
class Dwell:
    key: str
    duration_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """Something the plan concluded; it goes to the journal and to the observers, and nothing moves.

    `kind` is one of the journal's record kinds: ``ball``, ``event``, ``decision``.
    """

    key: str
    kind: str
    payload: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReadActiveBank:
    """Result: int."""

    key: str


@dataclass(frozen=True, slots=True)
class AwaitActive:
    """Raises NotActiveYet while `bank` waits for the controller before it acts."""

    key: str
    bank: int


@dataclass(frozen=True, slots=True)
class ReadTable:
    """Result: `TableImage`, or None where the bank is empty."""

    key: str
    bank: int


@dataclass(frozen=True, slots=True)
class StageTable:
    key: str
    bank: int
    table: TableImage


@dataclass(frozen=True, slots=True)
class ActivateBank:
    key: str
    bank: int


Step: TypeAlias = (
    MoveTo
    | Retrace
    | TouchTowards
    | HomeMount
    | OrientTo
    | ReadTemperatures
    | ReadClock
    | ReadPosition
    | CheckPermissions
    | ResetFault
    | CheckProbe
    | AskOperator
    | Dwell
    | Record
    | ReadActiveBank
    | AwaitActive
    | ReadTable
    | StageTable
    | ActivateBank
)

T = TypeVar("T")

Plan: TypeAlias = Generator[Step, Any, T]
"""Yields steps, is sent their results, returns its conclusion."""

STEPS_WITH_EFFECT = (
    MoveTo,
    Retrace,
    TouchTowards,
    HomeMount,
    OrientTo,
    ResetFault,
    AskOperator,
    Dwell,
    StageTable,
    ActivateBank,
    AwaitActive,
)
"""Steps that move or change something: durable in the journal before they begin."""
