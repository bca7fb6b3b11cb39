"""Steps that a plan can yield. A step is an immutable value that asks for one action and has a key; the engine carries
it out.

A kind of run is one plan. It yields not only motions and readings but everything that happens in a run: the states that
it enters (`Enter`), the values that it computes (`Conclude`) and the plans that it proves before it carries them out
(`ProvePlan`). A decision ends a plan: the plan returns a `Fork`, which names every way on. The preflight walks each of
them; on the machine, the engine chooses one and carries it out.

All code that depends on measured values is in functions (`compute`, `choose`, `reason`) that only the run on the
machine calls. The preflight continues with stand-ins, and the plan must not look into them.

The key names the place of the step in the procedure (``station-1/az090-el045/ball-03/touch-2``) and is unique in a run.
A plan that is rebuilt from the same settings and the same results has the same keys. A resumed run can therefore find
its recorded steps by their keys.

Positions are axis positions in mm as the controller displays them. They are plain tuples, which can be written to the
journal unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from agent.execution.states import RunState
from drivers.roles import OperatorRequest, TableImage

Point: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MoveTo:
    """Step: straight move of the axes to the axis positions `target_mm`. If no feed is given, the move is a rapid move.

    A guarded move (`guarded` is True) stops if the probe trips. Every move near the artefact is guarded.
    """

    key: str
    target_mm: Point
    feed_mm_per_s: float | None = None
    guarded: bool = True


@dataclass(frozen=True, slots=True)
class Retrace:
    """Step: move to the axis positions `target_mm` that repeats the end of an earlier step. `of` is the key of the
    earlier step. The move stops if the probe trips.

    The move approaches `target_mm` from the same side as the earlier step, and therefore takes up the play (backlash)
    of the axes in the same direction.
    """

    key: str
    target_mm: Point
    of: str
    feed_mm_per_s: float | None = None


@dataclass(frozen=True, slots=True)
class TouchTowards:
    """Step: probing move towards the axis positions `target_mm`.

    The result is a `Touch` with the axis positions latched at the trip if the probe trips on the way, and otherwise a
    `Miss`.
    """

    key: str
    target_mm: Point
    feed_mm_per_s: float


@dataclass(frozen=True, slots=True)
class HomeMount:
    key: str
    station: int


@dataclass(frozen=True, slots=True)
class HomeAxes:
    """Step: homing of all axes of the machine, in the sequence and on the paths of its controller. Afterwards the axes
    stand where the controller leaves them."""

    key: str


@dataclass(frozen=True, slots=True)
class OrientTo:
    """Step: turn of the rotary mount at `station` to the given azimuth and elevation.

    The result is the `Orientation` that the encoders of the mount report.
    """

    key: str
    station: int
    azimuth_deg: float
    elevation_deg: float


def accept_readings(_: Mapping[str, float], __: float) -> None:
    """Accept all readings of the thermometers."""


@dataclass(frozen=True, slots=True)
class ReadTemperatures:
    """Step: reading of all temperature sensors. The result maps sensor names to temperatures in °C.

    `require` receives this mapping and the machine time in s, and raises an error if the readings cannot be right. The
    step then has no result, and a run that is resumed reads again.
    """

    key: str
    require: Callable[[Mapping[str, float], float], None] = accept_readings


@dataclass(frozen=True, slots=True)
class ReadClock:
    """Step: reading of the clock of the run. The result is the machine time in s.

    In a resumed run, the time continues as if the run had not been interrupted.
    """

    key: str


@dataclass(frozen=True, slots=True)
class ReadPosition:
    """Step: reading of the axis positions. The result is a `Point`, the tuple (x, y, z) in mm; nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckPermissions:
    """Step: check of the permissions that the machine must grant before it may move. The step raises PermissionMissing
    if one is missing or the controller is in a fault.
    """

    key: str


@dataclass(frozen=True, slots=True)
class ResetFault:
    """Step: reset of a controller fault whose cause no longer exists. Nothing moves."""

    key: str


@dataclass(frozen=True, slots=True)
class CheckProbe:
    """Step: check of the touch probe. The step raises MeasurementFault if the probe is not loaded, is not healthy, or
    is deflected.
    """

    key: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Step: yes-or-no question to the operator. The step raises Aborted if the answer is no."""

    key: str
    request: OperatorRequest


@dataclass(frozen=True, slots=True)
class Dwell:
    key: str
    duration_s: float


@dataclass(frozen=True, slots=True)
class Record:
    """Step: passing of a conclusion of the plan, such as a measured ball centre, to the journal and to the observer of
    the engine. Nothing moves.

    `kind` is one of the journal's record kinds ``ball``, ``event`` and ``decision``.
    """

    key: str
    kind: str
    payload: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ReadActiveBank:
    """Step: reading of the number of the active bank, the controller's table memory whose compensation table is in use.
    The result is an int; 0 means no compensation.
    """

    key: str


@dataclass(frozen=True, slots=True)
class AwaitActive:
    """Step: check that `bank`, a table memory of the controller, has become active.

    The step raises NotActiveYet if the controller has accepted the request to activate the bank but has not yet
    activated it.
    """

    key: str
    bank: int


@dataclass(frozen=True, slots=True)
class ReadTable:
    """Step: reading of the compensation table in `bank`, a table memory of the controller. The result is a `TableImage`
    (the grid and its corrections), or None if the bank is empty or is bank 0, which means no compensation.
    """

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


def record_nothing(_: Any, __: Any) -> None:
    """Write no entry to the journal."""


@dataclass(frozen=True, slots=True)
class Enter:
    """Step: change of the state of the run to `state`. `reason` returns the explanation shown with the state."""

    key: str
    state: RunState
    reason: Callable[[], str] = str


@dataclass(frozen=True, slots=True)
class Conclude:
    """Step: computation of a value from what was measured. The result is the value that `compute` returns.

    `record` receives the journal of the run (`RunJournal`) and the result, and writes the entries of the conclusion. A
    resumed run computes the value again from the journaled measurements, and its entries are compared with those
    already written. In a preflight, the result is `stand_in`, and nothing is computed or recorded.
    """

    key: str
    compute: Callable[[], Any]
    stand_in: Any = None
    record: Callable[[Any, Any], None] = record_nothing


def known(key: str, value: object, record: Callable[[Any, Any], None] = record_nothing) -> Conclude:
    """Return the conclusion of a value that is known beforehand, so that it is also the stand-in of a preflight."""
    return Conclude(key, lambda: value, value, record)


@dataclass(frozen=True, slots=True)
class Decide:
    """Step: choice of one of `outcomes`, the names of the ways of a `Fork`. The result is the name that `choose`
    returns. A resumed run takes it from the journal."""

    key: str
    outcomes: tuple[str, ...]
    choose: Callable[[], str]


@dataclass(frozen=True, slots=True)
class ComputeOnce:
    """Step: computation of a record from what was measured, such as the ranking of the positions that may be measured
    next. `compute` returns a mapping of names to JSON values, which is the result of the step.

    The result is journaled: a resumed run takes it from the journal instead of computing it again. In a preflight, the
    result is an empty mapping.
    """

    key: str
    compute: Callable[[], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class ProvePlan:
    """Step: preflight of a plan that was chosen during the run, from where the machine stands.

    `prove` receives the axis positions in mm and a function that it calls repeatedly, which may raise an error to
    interrupt it. It returns the machine time of the plan in min, which is the result of the step, and raises
    PlanRefused if the plan cannot be carried out. In a preflight, the result is 0.0.
    """

    key: str
    prove: Callable[[Point, Callable[[], None]], float]


Step: TypeAlias = (
    MoveTo
    | Retrace
    | TouchTowards
    | HomeMount
    | HomeAxes
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
    | Enter
    | Conclude
    | Decide
    | ComputeOnce
    | ProvePlan
)

T = TypeVar("T")

Plan: TypeAlias = Generator[Step, Any, T]
"""Generator that yields steps, is sent their results, and returns its conclusion."""


@dataclass(frozen=True, slots=True)
class Fork:
    """Decision that ends a plan. `ways` maps the name of each outcome to a function that returns the rest of the plan,
    up to the end of the run.

    A decision can only be the last thing that a plan does, because a generator cannot be copied: the preflight walks
    each way as a plan of its own, from a copy of the simulated machine. `choose` returns the name of the outcome;
    `expected` is the outcome from which the machine time of the run is predicted. `key` is the key of the step
    `Decide`.

    `walked` names the outcomes that the preflight walks; if it is None, these are all. A way that is not walked
    beforehand must prove its motions (`ProvePlan`) before it moves anything.
    """

    key: str
    choose: Callable[[], str]
    ways: Mapping[str, Callable[[], RunPlan]]
    expected: str
    walked: tuple[str, ...] | None = None


RunPlan: TypeAlias = Generator[Step, Any, Fork | None]
"""Plan of a run or of a part of it that reaches the end of the run, by way of decisions if it returns a `Fork`."""

UNKEYED = (Record, Enter, Conclude)
"""Types of steps that the journal does not list by their keys: it holds their content as events, decisions, states and
results instead."""

STEPS_WITH_EFFECT = (
    MoveTo,
    Retrace,
    TouchTowards,
    HomeMount,
    HomeAxes,
    OrientTo,
    ResetFault,
    AskOperator,
    Dwell,
    StageTable,
    ActivateBank,
    AwaitActive,
)
"""Types of steps that move or change something; such a step is durable in the journal before it begins."""
