"""Steps that a plan can yield. A step is a frozen value with a stable key; the engine carries it out.

The key names the point in the procedure (``station-1/az090-el045/ball-03/touch-2``) and is unique in a run. It is the
same whenever the plan is rebuilt from the same settings and the same results, so that a resumed run can match its
recorded steps by key. Positions are axis positions in mm as the controller displays them; they are plain tuples, so
that a step can be written to the journal unchanged.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from drivers.roles import OperatorRequest, TableImage

Point: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Move in a straight line, which is a rapid move if no feed is given. Every move near the artefact is guarded."""

    key: str
    target_mm: Point
    feed_mm_per_s: float | None = None
    guarded: bool = True


@dataclass(frozen=True, slots=True)
class Retrace:
    """Guarded move that repeats the end of an earlier step. `of` is the key of that step.

    It approaches the same position from the same side, so that the play of the axes is taken up in the same direction.
    """

    key: str
    target_mm: Point
    of: str
    feed_mm_per_s: float | None = None


@dataclass(frozen=True, slots=True)
class TouchTowards:
    """Probing move towards `target_mm`. Result: `Touch` or `Miss`."""

    key: str
    target_mm: Point
    feed_mm_per_s: float


@dataclass(frozen=True, slots=True)
class HomeMount:
    key: str
    station: int


@dataclass(frozen=True, slots=True)
class OrientTo:
    """Turn of the mount at `station`. Result: the `Orientation` that its encoders report."""

    key: str
    station: int
    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class ReadTemperatures:
    """Reading of all sensors. The result maps sensor names to temperatures in °C."""

    key: str


@dataclass(frozen=True, slots=True)
class ReadClock:
    """Reading of the clock of the run.

    The result is the machine time in s; a resumed run continues from its last reading.
    """

    key: str


@dataclass(frozen=True, slots=True)
class ReadPosition:
    """Reading of the axis positions. The result is a `Point`; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckPermissions:
    """Check that raises PermissionMissing if the controller does not permit motion."""

    key: str


@dataclass(frozen=True, slots=True)
class ResetFault:
    """Reset of a controller fault whose cause is gone; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckProbe:
    """Check that raises MeasurementFault if the probe is not loaded, is not healthy, or is deflected."""

    key: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Question to the operator. Raises Aborted if the answer is no."""

    key: str
    request: OperatorRequest


@dataclass(frozen=True, slots=True)
class Dwell:
    key: str
    duration_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """Conclusion that the plan has reached, for the journal and the observers; nothing moves.

    `kind` is one of the journal's record kinds: ``ball``, ``event``, ``decision``.
    """

    key: str
    kind: str
    payload: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReadActiveBank:
    """Reading of the number of the active bank. The result is an int."""

    key: str


@dataclass(frozen=True, slots=True)
class AwaitActive:
    """Check that raises NotActiveYet if the controller has accepted `bank` but not yet activated it."""

    key: str
    bank: int


@dataclass(frozen=True, slots=True)
class ReadTable:
    """Reading of a table. The result is a `TableImage`, or None if the bank is empty."""

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
"""Generator that yields steps, is sent their results, and returns its conclusion."""

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
"""Types of steps that move or change something; such a step is durable in the journal before it begins."""
