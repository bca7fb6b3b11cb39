"""Test of the independent collision check (`collision_check.py`).

On random straight moves among the bodies on the table, its results (collision or not) are compared with those of the
simulator.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from campaigns.plans.collision_check import STEP_MM, TOLERANCE_MM, JudgeResult, ProbeDimensions, build_cloud, judge_tips
from campaigns.plans.random_cases import DrawnCase, draw, with_start
from drivers.errors import UserError
from simulators.world.mount import AZIMUTH, ELEVATION
from simulators.world.world import World

UNDECIDED_MM = 0.25
"""Clearance or overlap below which verdicts are not compared, because steps and spacing make them uncertain."""
FREE_AT_START_MM = 2.0


@dataclass(frozen=True)
class JudgeComparison:
    """Comparison of the collisions that the independent collision check finds with those that the simulator finds.

    `disagreed` contains a description of each disagreement, with the seed and the move.
    """

    moves: int = 0
    collisions: int = 0
    disagreed: tuple[str, ...] = ()

    @classmethod
    def sum(cls, many: Iterable[JudgeComparison]) -> Self:
        all_of_them = list(many)
        return cls(
            sum(one.moves for one in all_of_them),
            sum(one.collisions for one in all_of_them),
            tuple(text for one in all_of_them for text in one.disagreed),
        )


def compare_judge(seed: int, moves: int) -> JudgeComparison:
    """Compare the results of the independent collision check and of the simulator for `moves` random moves in the
    random case that `seed` gives.

    The moves are straight and unguarded, between random positions. If the agent refuses the files of the case, no move
    is compared.
    """
    with tempfile.TemporaryDirectory(prefix="volcal-provoked-") as directory:
        try:
            drawn = draw(seed, Path(directory))
        except UserError:
            return JudgeComparison()
        return JudgeComparison.sum(_compare_move(drawn, number) for number in range(moves))


def _compare_move(drawn: DrawnCase, number: int) -> JudgeComparison:
    rng = np.random.default_rng([drawn.seed, number, 7])
    limits = np.array(drawn.scenario.machine.limits)
    start, target = (rng.uniform(limits[:, 0], limits[:, 1]) for _ in range(2))
    world = World(with_start(drawn.scenario, (float(start[0]), float(start[1]), float(start[2]))))
    _turn(world, rng)
    dimensions = ProbeDimensions(drawn.job, 0.0)
    before, judged = JudgeResult(), JudgeResult()
    tool = np.array(world.controller.tool_offset)
    stand = world.workpiece.snapshot(world.now).pose
    cloud = build_cloud(
        drawn.job, np.asarray(world.workpiece.location_mm), np.asarray(stand.centre), np.asarray(stand.rotation)
    )
    judge_tips(before, start[None] + tool, cloud, dimensions)
    if before.collisions or before.smallest_mm < FREE_AT_START_MM or world.collisions:
        return JudgeComparison()
    count = int(np.ceil(np.linalg.norm(target - start) / STEP_MM)) + 1
    path = start + np.linspace(0.0, 1.0, count)[:, None] * (target - start)
    judge_tips(judged, path + tool, cloud, dimensions)
    world.controller.begin_move(target, None, guarded=False)
    ends = world.controller.motion_ends_s
    world.advance_to(world.now if ends is None else ends)
    return _verdict(drawn.seed, number, world, judged)


def _verdict(seed: int, number: int, world: World, judged: JudgeResult) -> JudgeComparison:
    crashed = bool(world.collisions)
    hit = bool(judged.collisions)
    deepest = max((float(text.split(", ")[1].split()[0]) for text in judged.collisions), default=0.0)
    doubtful = deepest < UNDECIDED_MM if hit else judged.smallest_mm < UNDECIDED_MM + TOLERANCE_MM
    if crashed == hit or doubtful:
        return JudgeComparison(1, int(crashed))
    said = f"{world.collisions[0].body_a} with {world.collisions[0].body_b}" if crashed else "no collision"
    return JudgeComparison(
        1, int(crashed), (f"seed {seed} move {number}: world {said}, judge {judged.collisions[:2]}",)
    )


def _turn(world: World, rng: np.random.Generator) -> None:
    world.workpiece.mount.begin_turn(AZIMUTH, float(rng.uniform(-90.0, 90.0)))
    world.workpiece.mount.begin_turn(ELEVATION, float(rng.uniform(-70.0, 70.0)))
    world.advance_to(world.workpiece.mount.settled_s)
