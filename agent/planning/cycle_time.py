"""Machine time of a set of positions, computed before anything moves. The plan of the run is executed on an ideal
machine, which only adds up the times of the steps.

No physics is simulated and no device is contacted. The execution of several thousand steps takes a fraction of a
second. The machine times of many position sets can therefore be compared. In contrast, `agent.planning.preflight` also
simulates the physics; both modules use the same `TimeModel`, the motion laws and latencies of the machine.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from agent.execution.engine import Engine
from agent.execution.steps import AskOperator, MoveTo, OrientTo, Plan, RunPlan, Step, TouchTowards
from agent.planning.ideal_machine import IdealMachine
from agent.planning.job import Job
from agent.planning.time_model import time_model
from agent.probing.ball import point
from agent.probing.paths.shortest_path import ShortestPathPlanner
from agent.probing.position import PositionTask, measure_position
from agent.probing.run_plan import MeasuringOrder, measure_positions, position_key
from twin.arrays import Array
from twin.artefact.position_set import MIN_BALLS, Position
from twin.collision.geometry import Point
from twin.units import S_PER_MIN

T = TypeVar("T")

PREFIX = "timed"
CARRYING, TURNING, MOVING, TOUCHING, WAITING = "carrying", "turning", "moving", "touching", "waiting"
PARTS = (CARRYING, TURNING, MOVING, TOUCHING, WAITING)
"""Parts of machine time: carrying by the operator, motion of mount and axes, touches, and the latency of all
commands."""

_MOTION = {OrientTo: TURNING, MoveTo: MOVING, TouchTowards: TOUCHING}


@dataclass(frozen=True)
class TimedStep:
    """Step of a plan with the time in s that it takes.

    `motion_s` is the time in which the axes or the mount move. `overhead_s` is the additional time: the latency of the
    command or, for a question to the operator, the time that the operator takes.
    """

    step: Step
    motion_s: float
    overhead_s: float

    @property
    def seconds(self) -> float:
        return self.motion_s + self.overhead_s

    @property
    def carrying(self) -> bool:
        return isinstance(self.step, AskOperator)


@dataclass(frozen=True)
class MachineMinutes:
    """Machine time of a set of positions, in minutes.

    `per_position` contains the time of each position, which includes the turn of the mount and the path to the
    position. This time is zero if fewer than three balls are within reach. `carrying` is the time in which the operator
    carries the artefact between stations. `total` is the sum of `carrying` and all values of `per_position`.
    """

    total: float
    per_position: Mapping[Position, float]
    carrying: float


def machine_minutes(job: Job, positions: Sequence[Position]) -> MachineMinutes:
    """Return the machine time for measuring `positions` in the given order.

    Positions at the same station must be contiguous. At the start, the axes are at the lower end of their travel, and
    azimuth and elevation of the rotary mount are zero. Only `positions` are timed; the held-out positions
    of `job` are not included.
    """
    listed = replace(job, positions=tuple(positions))
    _, steps = walk_plan(listed, expected_plan(set_alone(listed)))
    seconds: dict[str, float] = defaultdict(float)
    for timed in steps:
        if not timed.carrying:
            seconds[_position_of(timed.step.key)] += timed.seconds
    return MachineMinutes(
        total=sum(timed.seconds for timed in steps) / S_PER_MIN,
        per_position={p: seconds[position_key(p)] / S_PER_MIN for p in listed.positions},
        carrying=sum(timed.seconds for timed in steps if timed.carrying) / S_PER_MIN,
    )


def set_alone(job: Job) -> RunPlan:
    """Return the plan that measures the positions of `job` in the given order and nothing else: neither the checks
    before a run nor its held-out positions. Studies compare position sets by it; no run carries it out."""
    order = MeasuringOrder(PREFIX, job.positions, job.settings.stations.standing_at)
    yield from measure_positions(order, job.layout, job.rules)
    return None


def position_minutes(job: Job, position: Position) -> float:
    """Return the machine minutes that the measurement of `position` adds if other positions are measured at its station
    too.

    If the settings ask for free paths (shortest collision-free paths), the time begins at the end of a measurement of
    ball 0 with both mount angles zero, and ends after the last ball of `position`. If they ask for plain paths (by way
    of the retreat plane), the tip starts and ends at the park location beside the station.
    """
    retreat = job.rules.retreat
    if retreat.path_rules is None:
        parked = point(retreat.park_location(job.layout.nominal(position).mean(axis=0), position.station))
        return plan_minutes(job, _there_and_back(job, position, parked), parked)
    planner = ShortestPathPlanner(retreat.path_rules.finder_for(job.layout), retreat, job.rules.probing)
    here = planner.assume_measured(position.station)
    return plan_minutes(job, _one_more(job, position, here, planner), point(here))


def minutes_at_balls(job: Job, position: Position, after: Position) -> float:
    """Return the machine minutes from the first touch of `position` to the last: its measurement without the turn of
    the mount and without the ways to the first ball and from the last.

    `after` is a position at the same station that is measured before, so that the place of the mount is known.
    """
    order = MeasuringOrder(PREFIX, (after, position), position.station)
    _, steps = walk_plan(job, measure_positions(order, job.layout, job.rules))
    own = f"{PREFIX}/{position_key(position)}/"
    touches = [n for n, one in enumerate(steps) if isinstance(one.step, TouchTowards) and one.step.key.startswith(own)]
    if not touches:
        return 0.0
    return sum(timed.seconds for timed in steps[touches[0] : touches[-1] + 1]) / S_PER_MIN


def plan_minutes(job: Job, plan: Plan[object], start_mm: Point | None = None) -> float:
    """Return the machine minutes of `plan` on an ideal machine, see `walk_plan`."""
    _, steps = walk_plan(job, plan, start_mm)
    return sum(timed.seconds for timed in steps) / S_PER_MIN


def without_optimisation(job: Job) -> Job:
    """Return a copy of `job` with plain paths, which lead by way of the retreat plane, and with a measuring order that
    is not optimised.

    Stations and positions are then measured in the order in which they are listed. The held-out positions are those of
    `job`: a plain path to a position that was chosen for shortest paths is not proved to be free of collisions.
    """
    procedure = job.settings.procedure.model_copy(update={"paths": "plain", "optimise_order": False})
    rules = replace(job.rules, retreat=replace(job.rules.retreat, path_rules=None))
    return replace(job, settings=job.settings.model_copy(update={"procedure": procedure}), rules=rules)


def minutes_by_part(steps: Iterable[TimedStep]) -> dict[int, dict[str, float]]:
    """Return the machine minutes of each station, divided into the parts carrying, turning, moving, touching and
    waiting.

    The result maps the number of each station to a mapping from the name of each part to minutes.
    """
    minutes: dict[int, dict[str, float]] = defaultdict(lambda: dict.fromkeys(PARTS, 0.0))
    for timed in steps:
        station = minutes[_station_of(timed.step)]
        if timed.carrying:
            station[CARRYING] += timed.seconds / S_PER_MIN
        else:
            station[_MOTION[type(timed.step)]] += timed.motion_s / S_PER_MIN
            station[WAITING] += timed.overhead_s / S_PER_MIN
    return {station: dict(minutes[station]) for station in sorted(minutes)}


def expected_plan(plan: RunPlan) -> Plan[None]:
    """Return a plan that yields the steps of `plan` and, at each decision, those of the way that is expected."""
    fork = yield from plan
    while fork is not None:
        fork = yield from fork.ways[fork.expected]()


def walk_plan(job: Job, plan: Plan[T], start_mm: Point | None = None) -> tuple[T, list[TimedStep]]:
    """Execute `plan` on an ideal machine. Return a pair: the result of the plan, and the steps that take time, in
    order.

    `start_mm` contains the axis positions at the start in mm. If `start_mm` is None, the axes start at
    `job.start_mm`.
    """
    steps: list[TimedStep] = []

    def note(step: Step, motion_s: float, overhead_s: float) -> None:
        steps.append(TimedStep(step, motion_s, overhead_s))

    model = time_model(job.machine, job.settings.timing)
    start = start_mm or job.start_mm
    concluded = Engine(IdealMachine(job.layout, model, start, note).actions()).run(plan)
    return concluded, steps


def _there_and_back(job: Job, position: Position, parked: Point) -> Plan[None]:
    order = MeasuringOrder(PREFIX, (position,), position.station)
    measured = yield from measure_positions(order, job.layout, job.rules)
    if measured.positions:
        yield MoveTo(f"{PREFIX}/{position_key(position)}/park-again", parked)


def _one_more(job: Job, position: Position, here: Array, planner: ShortestPathPlanner) -> Plan[None]:
    nominal = job.layout.nominal(position)
    mask = job.layout.reachable(position, nominal)
    if mask.sum() < MIN_BALLS:
        return
    key = f"{PREFIX}/{position_key(position)}"
    task = PositionTask(key, 0, position.station, position.azimuth_deg, position.elevation_deg, nominal, mask)
    yield from measure_position(task, here, job.rules, (), planner)


def _position_of(key: str) -> str:
    """Return ``station-1/az45-el0`` for ``measure/station-1/az45-el0/ball-03/touch-2``; see `position_key`."""
    _, station, orientation, *_ = key.split("/")
    return f"{station}/{orientation}"


def _station_of(step: Step) -> int:
    if isinstance(step, AskOperator):
        return step.request.station or 0
    return int(step.key.split("/")[1].removeprefix("station-"))
