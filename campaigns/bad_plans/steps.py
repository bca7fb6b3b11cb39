"""Bad plans (plans that the agent must refuse) with correct files and wrong steps.

In each plan one step of the agent's procedure is replaced or omitted, or a further step is inserted before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from agent.errors import PlanRefused
from agent.execution import steps as s
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.probing.run_plan import VERIFIED
from agent.runs.kinds.calibrate import calibration_of
from campaigns.bad_plans.mutation import BadPlan, unchanged
from drivers.errors import ConfigurationError
from drivers.roles import TableImage

Rewrite = Callable[[s.Step], Iterable[s.Step] | None]
"""Function that returns the steps that replace a step, or None to keep the step.

The procedure receives the result of the last replacing step.
"""

BEYOND_MM = 1.0
TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.zeros((2, 2, 2, 3), dtype=np.int32))


def rewrite_plan(plan: s.RunPlan, rewrite: Rewrite) -> s.RunPlan:
    """Return a plan with the steps of `plan`, and of the ways on from its decisions, replaced as `rewrite` says."""
    result: Any = None
    while True:
        try:
            step = plan.send(result)
        except StopIteration as stop:
            return _rewrite_ways(stop.value, rewrite)
        instead = rewrite(step)
        for one in (step,) if instead is None else instead:
            result = yield one


def _rewrite_ways(fork: s.Fork | None, rewrite: Rewrite) -> s.Fork | None:
    if fork is None:
        return None
    ways = {name: lambda way=way: rewrite_plan(way(), rewrite) for name, way in fork.ways.items()}
    return replace(fork, ways=ways)


def replace_first(
    matches: Callable[[s.Step], bool],
    instead: Callable[[s.Step], Iterable[s.Step]],
    *,
    every_branch: bool = False,
) -> Callable[[Job], object]:
    """Return a function that runs the preflight of the calibration of a job with one step of its
    plan replaced.

    The first step for which `matches` returns True is replaced by the steps that `instead` returns. If `every_branch`
    is True, all branches of the plan are executed, not only the expected one. The returned function raises LookupError
    if no step matches.
    """

    def preflight(job: Job) -> object:
        done: list[str] = []

        def rewrite(step: s.Step) -> Iterable[s.Step] | None:
            if done or not matches(step):
                return None
            done.append(step.key)
            return instead(step)

        result = run_preflight(
            job, lambda prepared: rewrite_plan(calibration_of(prepared), rewrite), every_branch=every_branch
        )
        return result if done else _never_came()

    return preflight


def _never_came() -> object:
    """Raise LookupError, because a plan in which no step was mutated proves nothing."""
    raise LookupError("no step of the procedure was mutated")


def is_touch(step: s.Step) -> bool:
    return isinstance(step, s.TouchTowards)


def is_move(step: s.Step) -> bool:
    return isinstance(step, s.MoveTo)


def is_kind(*kinds: type) -> Callable[[s.Step], bool]:
    return lambda step: isinstance(step, kinds)


def before(*extra: s.Step) -> Callable[[s.Step], Iterable[s.Step]]:
    return lambda step: (*extra, step)


def changed(**values: object) -> Callable[[s.Step], Iterable[s.Step]]:
    return lambda step: (replace(step, **values),)  # type: ignore[arg-type]


def move_to(x: float, y: float, z: float, **options: Any) -> s.MoveTo:
    return s.MoveTo(f"mutated/move-{x:g}-{y:g}-{z:g}", (x, y, z), **options)


def refused_plan(name: str, preflight: Callable[[Job], object], *words: str, step: str = "") -> BadPlan:
    where = {"step": step} if step else None
    return BadPlan(f"steps: {name}", unchanged, PlanRefused, ("preflight", *words), where, preflight)


def _outside() -> list[BadPlan]:
    """Return moves beyond each end of each axis by one millimetre."""
    ends = {"X": (0.0, 4000.0), "Y": (0.0, 1300.0), "Z": (0.0, 1500.0)}
    bad = []
    for place, (axis, (low, high)) in enumerate(ends.items()):
        for value in (low - BEYOND_MM, high + BEYOND_MM):
            target = [2000.0, 0.0, 1400.0]
            target[place] = value
            bad.append(
                refused_plan(
                    f"{axis} {value:g}",
                    replace_first(is_touch, before(move_to(*target))),
                    f"{axis} {value:.3f} mm is outside",
                )
            )
    return bad


def _odd_numbers() -> list[BadPlan]:
    bad = []
    for value in (math.nan, math.inf, -math.inf):
        bad.append(
            refused_plan(f"target {value}", replace_first(is_touch, before(move_to(value, 0.0, 0.0))), "X", "outside")
        )
        bad.append(
            refused_plan(
                f"touch target {value}",
                replace_first(is_touch, changed(target_mm=(700.0, value, 750.0))),
                "Y",
                "outside",
            )
        )
    for value in (math.nan, math.inf, 0.0, -5.0):
        bad.append(refused_plan(f"feed {value}", replace_first(is_move, changed(feed_mm_per_s=value)), "a feed of"))
        bad.append(
            refused_plan(f"touch feed {value}", replace_first(is_touch, changed(feed_mm_per_s=value)), "a touch at")
        )
        if value != 0.0:
            bad.append(
                refused_plan(
                    f"wait {value}", replace_first(is_touch, before(s.Dwell("mutated/dwell", value))), "a wait of"
                )
            )
    bad.append(
        refused_plan(
            "touch feed of a rapid", replace_first(is_touch, changed(feed_mm_per_s=200.0)), "a touch at 200.0 mm/s"
        )
    )
    for azimuth, elevation, axis in ((200.0, 0.0, "azimuth"), (0.0, 120.0, "elevation"), (math.nan, 0.0, "azimuth")):
        preflight = replace_first(is_kind(s.OrientTo), changed(azimuth_deg=azimuth, elevation_deg=elevation))
        bad.append(
            refused_plan(f"orientation {azimuth:g} {elevation:g}", preflight, axis, "is outside", step="measure")
        )
    return bad


def _through() -> list[BadPlan]:
    """Return straight moves through the bodies at station 1.

    Its mount is at (700, 1000, 750) mm in the workpiece frame.
    """
    right, left = (1150.0, 560.0, 750.0), (250.0, 700.0, 750.0)
    return [
        refused_plan(
            "moved through the bar, unguarded",
            replace_first(is_touch, before(move_to(*right, guarded=False))),
            "unguarded",
        ),
        refused_plan(
            "moved through the bar", replace_first(is_touch, before(move_to(700.0, 950.0, 750.0))), step="mutated/move"
        ),
        refused_plan(
            "body against the pedestal",
            replace_first(is_touch, before(move_to(700.0, 1100.0, 450.0))),
            "with",
            step="mutated/move",
        ),
        refused_plan(
            "across the mount",
            replace_first(is_touch, before(move_to(1300.0, 0.0, 750.0), move_to(700.0, 1000.0, 780.0))),
            "with",
        ),
        refused_plan(
            "along the bar at its depth", replace_first(is_touch, before(move_to(*left))), step="mutated/move"
        ),
    ]


_TURN = s.OrientTo("mutated/turn", 1, 60.0, 25.0)
_FIRST_ORIENT = is_kind(s.OrientTo)


def _in_contact() -> list[BadPlan]:
    return [
        refused_plan(
            "turned into the probe", replace_first(is_touch, before(_TURN)), "collision", "with", step="mutated/turn"
        ),
        refused_plan("touched while touching", replace_first(is_touch, _twice), "deflected", step="mutated/again"),
        refused_plan(
            "rapid onto the ball instead of touching",
            replace_first(is_touch, _as_move),
            "tip with ball 0",
            step="mutated/move",
        ),
        refused_plan(
            "moved onto the ball instead of touching",
            replace_first(is_touch, _as_slow_move),
            "tripped",
            step="mutated/move",
        ),
    ]


def _order() -> list[BadPlan]:
    return [
        refused_plan("never turned", replace_first(_FIRST_ORIENT, lambda _: ()), "not found where it was expected"),
        refused_plan("turned elsewhere", replace_first(_FIRST_ORIENT, changed(azimuth_deg=50.0)), "measure"),
        refused_plan(
            "touched first",
            replace_first(lambda _: True, before(s.TouchTowards("mutated/t", (0.0, 1.0, 0.0), 5.0))),
            "touches",
        ),
        refused_plan(
            "moved first",
            replace_first(lambda _: True, before(move_to(0.0, 0.0, 0.0))),
            "permissions",
            step="mutated/move",
        ),
        refused_plan("turned first", replace_first(lambda _: True, before(_TURN)), "permissions", step="mutated/turn"),
        refused_plan(
            "no look at the probe", replace_first(is_kind(s.CheckProbe), lambda _: ()), "touches before the probe"
        ),
        refused_plan("unguarded", replace_first(is_move, changed(guarded=False)), "unguarded"),
        refused_plan(
            "unguarded near the ball", replace_first(_near, changed(guarded=False)), "unguarded", step="measure"
        ),
    ]


def _out_of_place() -> list[BadPlan]:
    return [
        refused_plan(
            "wrong station", replace_first(_FIRST_ORIENT, changed(station=2)), "station 2", "stands at station 1"
        ),
        refused_plan(
            "station that is not there", replace_first(_FIRST_ORIENT, changed(station=9)), "station 9", "there are 4"
        ),
        refused_plan(
            "home of no station", replace_first(_FIRST_ORIENT, before(s.HomeMount("mutated/home", 0))), "station 0"
        ),
        refused_plan(
            "two steps of one key", replace_first(is_touch, before(s.ReadPosition("measure/permissions"))), "same key"
        ),
        refused_plan(
            "written while measuring",
            replace_first(is_touch, before(s.StageTable("mutated/stage", 1, TABLE))),
            "must not write",
        ),
        refused_plan(
            "activated while measuring",
            replace_first(is_touch, before(s.ActivateBank("mutated/bank", 1))),
            "must not write",
        ),
        refused_plan(
            "written while verifying",
            replace_first(_verifies, before(s.StageTable("mutated/stage", 1, TABLE))),
            "must not write",
            step="mutated/stage",
        ),
        refused_plan(
            "unguarded where the former table is restored",
            replace_first(_restores, before(move_to(700.0, 0.0, 750.0, guarded=False)), every_branch=True),
            "unguarded",
            step="mutated/move",
        ),
        BadPlan("steps: nothing proved", unchanged, ConfigurationError, ("could not be proved",), None, _unproved),
    ]


def _twice(step: s.Step) -> Iterable[s.Step]:
    return step, replace(step, key="mutated/again")


def _as_move(step: s.Step) -> Iterable[s.Step]:
    assert isinstance(step, s.TouchTowards)
    return (s.MoveTo("mutated/move", step.target_mm),)


def _as_slow_move(step: s.Step) -> Iterable[s.Step]:
    assert isinstance(step, s.TouchTowards)
    return (s.MoveTo("mutated/move", step.target_mm, step.feed_mm_per_s),)


def _near(step: s.Step) -> bool:
    return isinstance(step, s.MoveTo) and "/touch-1" in step.key


def _verifies(step: s.Step) -> bool:
    return is_touch(step) and step.key.startswith("verify/")


def _restores(step: s.Step) -> bool:
    return step.key == "restore/activate"


_unproved = replace_first(lambda step: step.key == VERIFIED, lambda step: (_without_positions(step),))


def _without_positions(step: s.Step) -> s.Step:
    assert isinstance(step, s.Conclude)
    return replace(step, stand_in=replace(step.stand_in, positions=()))


def step_plans() -> list[BadPlan]:
    return [*_outside(), *_odd_numbers(), *_through(), *_in_contact(), *_order(), *_out_of_place()]
