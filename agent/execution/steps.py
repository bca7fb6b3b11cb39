"""Steps that a plan can yield. A step is a frozen value with a key; the engine carries it out.

The key names the point in the procedure (``station-1/az090-el045/ball-03/touch-2``) and is unique in a run. A plan that
is rebuilt from the same settings and the same results has the same keys. A resumed run can therefore find its recorded
steps by their keys.

Positions are axis positions in mm as the controller displays them. They are plain tuples, which can be written to the
journal unchanged.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from drivers.roles import OperatorRequest, TableImage

Point: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Straight move of the axes to `target_mm`. If no feed is given, the move is a rapid move.

    A guarded move stops if the probe trips. Every move near the artefact is guarded.
    """

    key: str
    target_mm: Point
    feed_mm_per_s: float | None = None
    guarded: bool = True


@dataclass(frozen=True, slots=True)
class Retrace:
    """Guarded move that repeats the end of an earlier step. `of` is the key of the earlier step.

    The move approaches `target_mm` from the same side as the earlier step, and therefore takes up the play of the axes
    in the same direction.
    """

    key: str
    target_mm: Point
    of: str
    feed_mm_per_s: float | None = None


@dataclass(frozen=True, slots=True)
class TouchTowards:
    """Probing move towards `target_mm`.

    The result is a `Touch` if the probe trips on the way, and otherwise a `Miss`.
    """

    key: str
    target_mm: Point
    feed_mm_per_s: float


@dataclass(frozen=True, slots=True)
class HomeMount:
    key: str
    station: int


@dataclass(frozen=True, slots=True)
class OrientTo:
    """Turn of the mount at `station` to the given angles.

    The result is the `Orientation` that the encoders of the mount report.
    """

    key: str
    station: int
    azimuth_deg: float
    elevation_deg: float


@dataclass(frozen=True, slots=True)
class ReadTemperatures:
    """Reading of all temperature sensors. The result maps sensor names to temperatures in °C."""

    key: str


@dataclass(frozen=True, slots=True)
class ReadClock:
    """Reading of the clock of the run. The result is the machine time in s.

    In a resumed run, the time continues as if the run had not been interrupted.
    """

    key: str


@dataclass(frozen=True, slots=True)
class ReadPosition:
    """Reading of the axis positions. The result is a `Point`; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckPermissions:
    """Check of the permissions. It raises PermissionMissing if the controller does not permit motion."""

    key: str


@dataclass(frozen=True, slots=True)
class ResetFault:
    """Reset of a controller fault whose cause no longer exists. Nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckProbe:
    """Check of the probe. It raises MeasurementFault if the probe is not loaded, is not healthy, or is deflected."""

    key: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Question to the operator. The step raises Aborted if the answer is no."""

    key: str
    request: OperatorRequest


@dataclass(frozen=True, slots=True)
class Dwell:
    key: str
    duration_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """Conclusion that the plan has reached and passes to the journal and the observers. Nothing moves.

    `kind` is one of the journal's record kinds ``ball``, ``event`` and ``decision``.
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
    """Check of the activation of `bank`.

    The step raises NotActiveYet if the controller has accepted the request to activate the bank but has not yet
    activated it.
    """

    key: str
    bank: int


@dataclass(frozen=True, slots=True)
class ReadTable:
    """Reading of the table in `bank`. The result is a `TableImage`, or None if the bank is empty."""

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
