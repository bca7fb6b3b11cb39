"""Good files, bad steps: the procedure as the agent makes it, with one step replaced, left out or put in."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from agent.errors import PlanRefused
from agent.execution import steps as s
from agent.planning.job import Job
from agent.planning.preflight import run_preflight, whole_procedure
from agent.probing.run_plan import Measured
from campaigns.bad_plans.mutation import Bad, unchanged
from drivers.errors import ConfigurationError
from drivers.roles import TableImage

Rewrite = Callable[[s.Step], Iterable[s.Step] | None]
"""What is done in the place of a step; None: the step as it is. The last one's result is that of the step."""
Both = tuple[Measured, Measured]

BEYOND_MM = 1.0
TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((2, 2, 2, 3), dtype=np.int32))


def rewritten(plan: s.Plan[Both], rewrite: Rewrite) -> s.Plan[Both]:
    result: Any = None
    while True:
        try:
            step = plan.send(result)
        except StopIteration as stop:
            both: Both = stop.value
            return both
        instead = rewrite(step)
        for one in (step,) if instead is None else instead:
            result = yield one


def once(matches: Callable[[s.Step], bool], instead: Callable[[s.Step], Iterable[s.Step]]) -> Callable[[Job], object]:
    """Return a preflight of the whole procedure in which the first step that matches is replaced by `instead`."""

    def preflight(job: Job) -> object:
        done: list[str] = []

        def rewrite(step: s.Step) -> Iterable[s.Step] | None:
            if done or not matches(step):
                return None
            done.append(step.key)
            return instead(step)

        result = run_preflight(job, procedure=lambda prepared: rewritten(whole_procedure(prepared), rewrite))
        return result if done else _never_came()

    return preflight


def _never_came() -> object:
    """A mutation that never came to its step proves nothing."""
    raise LookupError("no step of the procedure was mutated")


def touch(step: s.Step) -> bool:
    return isinstance(step, s.TouchTowards)


def move(step: s.Step) -> bool:
    return isinstance(step, s.MoveTo)


def kind(*kinds: type) -> Callable[[s.Step], bool]:
    return lambda step: isinstance(step, kinds)


def before(*extra: s.Step) -> Callable[[s.Step], Iterable[s.Step]]:
    return lambda step: (*extra, step)


def changed(**values: object) -> Callable[[s.Step], Iterable[s.Step]]:
    return lambda step: (replace(step, **values),)  # type: ignore[arg-type]


def to(x: float, y: float, z: float, **options: Any) -> s.MoveTo:
    return s.MoveTo(f"mutated/move-{x:g}-{y:g}-{z:g}", (x, y, z), **options)


def refused(name: str, preflight: Callable[[Job], object], *words: str, step: str = "") -> Bad:
    where = {"step": step} if step else None
    return Bad(f"steps: {name}", unchanged, PlanRefused, ("preflight", *words), where, preflight)


def _outside() -> list[Bad]:
    """Each end of each axis, by one millimetre."""
    ends = {"X": (0.0, 4000.0), "Y": (0.0, 1300.0), "Z": (0.0, 1500.0)}
    bad = []
    for place, (axis, (low, high)) in enumerate(ends.items()):
        for value in (low - BEYOND_MM, high + BEYOND_MM):
            target = [2000.0, 0.0, 1400.0]
            target[place] = value
            bad.append(
                refused(f"{axis} {value:g}", once(touch, before(to(*target))), f"{axis} {value:.3f} mm is outside")
            )
    return bad


def _odd_numbers() -> list[Bad]:
    bad = []
    for value in (math.nan, math.inf, -math.inf):
        bad.append(refused(f"target {value}", once(touch, before(to(value, 0.0, 0.0))), "X", "outside"))
        bad.append(
            refused(f"touch target {value}", once(touch, changed(target_mm=(700.0, value, 750.0))), "Y", "outside")
        )
    for value in (math.nan, math.inf, 0.0, -5.0):
        bad.append(refused(f"feed {value}", once(move, changed(feed_mm_per_s=value)), "a feed of"))
        bad.append(refused(f"touch feed {value}", once(touch, changed(feed_mm_per_s=value)), "a touch at"))
        if value != 0.0:
            bad.append(refused(f"wait {value}", once(touch, before(s.Dwell("mutated/dwell", value))), "a wait of"))
    bad.append(refused("touch feed of a rapid", once(touch, changed(feed_mm_per_s=200.0)), "a touch at 200.0 mm/s"))
    for azimuth, elevation, axis in ((200.0, 0.0, "azimuth"), (0.0, 120.0, "elevation"), (math.nan, 0.0, "azimuth")):
        preflight = once(kind(s.OrientTo), changed(azimuth_deg=azimuth, elevation_deg=elevation))
        bad.append(refused(f"orientation {azimuth:g} {elevation:g}", preflight, axis, "is outside", step="measure"))
    return bad


def _through() -> list[Bad]:
    """Straight ways through what stands at station 1, whose foot is at (700, 1000, 750) in the workpiece frame."""
    right, left = (1150.0, 560.0, 750.0), (250.0, 700.0, 750.0)
    return [
        refused("moved through the bar, unguarded", once(touch, before(to(*right, guarded=False))), "unguarded"),
        refused("moved through the bar", once(touch, before(to(700.0, 950.0, 750.0))), step="mutated/move"),
        refused(
            "body against the pedestal", once(touch, before(to(700.0, 1100.0, 450.0))), "with", step="mutated/move"
        ),
        refused("across the mount", once(touch, before(to(1300.0, 0.0, 750.0), to(700.0, 1000.0, 780.0))), "with"),
        refused("along the bar at its depth", once(touch, before(to(*left))), step="mutated/move"),
    ]


def _order() -> list[Bad]:
    def twice(step: s.Step) -> Iterable[s.Step]:
        return step, replace(step, key="mutated/again")

    def as_move(step: s.Step) -> Iterable[s.Step]:
        assert isinstance(step, s.TouchTowards)
        return (s.MoveTo("mutated/move", step.target_mm),)

    def as_slow_move(step: s.Step) -> Iterable[s.Step]:
        assert isinstance(step, s.TouchTowards)
        return (s.MoveTo("mutated/move", step.target_mm, step.feed_mm_per_s),)

    turn = s.OrientTo("mutated/turn", 1, 60.0, 25.0)
    first_orient = kind(s.OrientTo)
    return [
        refused("turned into the probe", once(touch, before(turn)), "collision", "with", step="mutated/turn"),
        refused("touched while touching", once(touch, twice), "deflected", step="mutated/again"),
        refused(
            "rapid onto the ball instead of touching", once(touch, as_move), "tip with ball 0", step="mutated/move"
        ),
        refused("moved onto the ball instead of touching", once(touch, as_slow_move), "tripped", step="mutated/move"),
        refused("never turned", once(first_orient, lambda _: ()), "not found where it was expected"),
        refused("turned elsewhere", once(first_orient, changed(azimuth_deg=50.0)), "measure"),
        refused(
            "touched first", once(lambda _: True, before(s.TouchTowards("mutated/t", (0.0, 1.0, 0.0), 5.0))), "touches"
        ),
        refused("moved first", once(lambda _: True, before(to(0.0, 0.0, 0.0))), "permissions", step="mutated/move"),
        refused("turned first", once(lambda _: True, before(turn)), "permissions", step="mutated/turn"),
        refused("no look at the probe", once(kind(s.CheckProbe), lambda _: ()), "touches before the probe"),
        refused("wrong station", once(first_orient, changed(station=2)), "station 2", "stands at station 1"),
        refused("station that is not there", once(first_orient, changed(station=9)), "station 9", "there are 4"),
        refused("home of no station", once(first_orient, before(s.HomeMount("mutated/home", 0))), "station 0"),
        refused("two steps of one key", once(touch, before(s.ReadPosition("measure/permissions"))), "same key"),
        refused(
            "written while measuring", once(touch, before(s.StageTable("mutated/stage", 1, TABLE))), "must not write"
        ),
        refused("activated while measuring", once(touch, before(s.ActivateBank("mutated/bank", 1))), "must not write"),
        refused("unguarded", once(move, changed(guarded=False)), "unguarded"),
        refused("unguarded near the ball", once(_near, changed(guarded=False)), "unguarded", step="measure"),
        Bad("steps: nothing proved", unchanged, ConfigurationError, ("could not be proved",), None, _unproved),
    ]


def _near(step: s.Step) -> bool:
    return isinstance(step, s.MoveTo) and "/touch-1" in step.key


def _unproved(job: Job) -> object:
    def procedure(prepared: Job) -> s.Plan[Both]:
        measured, verified = yield from whole_procedure(prepared)
        return measured, replace(verified, positions=())

    return run_preflight(job, procedure=procedure)


def in_steps() -> list[Bad]:
    return [*_outside(), *_odd_numbers(), *_through(), *_order()]
