"""Machine minutes that rounded corners of free moves could save: the controller blends the moves of a way instead of
stopping at each corner.

A way is a sequence of moves without a touch, a turn or a question in between. The controller may leave the straight
moves within a tolerance from each corner. Three figures are computed, for two laws of rounding:

- same ways: those of the run with exact stops. Only the lengths of the moves limit the rounding.
- best ways: those that are fastest if their corners are rounded.
- with clearance: the same if the tolerance is added to the clearance from all bodies, as a proof that the rounded way
  is free would do. The balls at both ends of a way keep their smaller clearance; the rounding beside them is not
  proved.

`python -m benchmarks.blending --case quick mill` computes the shipped cases that are named, without `--case` the case
quick. With the option `--json`, the output is one line of JSON for each case.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from agent.execution.engine import Engine
from agent.execution.steps import MoveTo, ReadPosition, Step
from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import TimedStep, expected_plan
from agent.planning.ideal_machine import IdealMachine
from agent.planning.job import Job
from agent.planning.run_minutes import MEASURING, held_out_keys, phase_of
from agent.planning.time_model import time_model
from agent.runs.kinds.calibrate import calibration_of
from twin.arrays import Array
from twin.collision.free_paths import AxisDynamics
from twin.collision.geometry import Point
from twin.units import S_PER_MIN

TOLERANCES_MM = (0.5, 1.0, 2.0, 5.0)
_SPEEDS = 33
"""Corner speeds that are compared, from a stop to the largest one. With four times as many, the set of the case quick
is faster by 0.004 min at 2 mm and by 0.010 min at 5 mm."""
_COINCIDENT_MM = 1e-7
_TINY = 1e-12


class CornerLaw(Enum):
    """Motion of the tip at a rounded corner.

    `OVERLAP`: the axes change from the velocity of one move to that of the next with constant accelerations, all in the
    same time, the shortest that the limits of the axes permit (a parabola). LinuxCNC calls this parabolic blending.
    `ARC`: a circular arc at the speed at which its centripetal acceleration is that of the slowest axis. The speed is
    also that of the junction deviation of GRBL.
    """

    OVERLAP = "overlap"
    ARC = "arc"


@dataclass(frozen=True)
class BlendedDynamics(AxisDynamics):
    """Dynamics of the axes if the corners of a path are rounded by at most `tolerance_mm` according to `law`."""

    tolerance_mm: float = 0.0
    law: CornerLaw = CornerLaw.OVERLAP

    def moving_seconds(self, corners: Array) -> Array:
        return self.way_seconds(corners, np.full(corners.shape[1] - 1, np.inf))

    def way_seconds(self, stops: Array, feeds_mm_per_s: Array) -> Array:
        """Return the duration in s of each of n ways through the points `stops` (n, k, 3) in mm, without `command_s`.
        The points include start and end. `feeds_mm_per_s` (k - 1,) is the feed of each move; inf is rapid traverse.

        A way begins and ends at rest. The corner speeds are those of the fastest way among `_SPEEDS` for each corner.
        """
        moves = np.diff(stops, axis=1)
        lengths = np.sqrt((moves * moves).sum(axis=2))
        real = lengths > _COINCIDENT_MM
        seconds = np.zeros(len(stops))
        # Ways with the same number of moves of non-zero length are computed together.
        for count in sorted({*real.sum(axis=1).tolist()} - {0}):
            ways = real.sum(axis=1) == count
            kept = real[ways]
            feeds = np.broadcast_to(feeds_mm_per_s, kept.shape)[kept].reshape(-1, count)
            length = lengths[ways][kept].reshape(-1, count)
            directions = moves[ways][kept].reshape(-1, count, 3) / length[..., None]
            seconds[ways] = self._fastest(length, directions, feeds)
        return seconds

    def _fastest(self, lengths: Array, directions: Array, feeds: Array) -> Array:
        """Return the duration in s of each of n ways of m moves with the given `lengths` (n, m) in mm, unit vectors
        `directions` (n, m, 3) and `feeds` (n, m) in mm/s. Dynamic programming over the speed at each corner."""
        speeds = np.minimum(feeds, _limit_along(directions, self.rapid_mm_per_s))
        accelerations = _limit_along(directions, self.acceleration_mm_per_s2)
        at_rest = np.zeros((len(lengths), 1))
        before = (at_rest, at_rest, at_rest)
        cost = at_rest
        for move in range(lengths.shape[1]):
            last = move + 1 == lengths.shape[1]
            after = (at_rest, at_rest, at_rest) if last else self._corner(lengths, directions, speeds, move)
            straight_s = _straight_s(
                lengths[:, move, None, None] - before[2][:, :, None] - after[2][:, None, :],
                before[0][:, :, None],
                after[0][:, None, :],
                speeds[:, move, None, None],
                accelerations[:, move, None, None],
            )
            cost = (cost[:, :, None] + straight_s).min(axis=1) + after[1]
            before = after
        return np.asarray(cost[:, 0])

    def _corner(self, lengths: Array, directions: Array, speeds: Array, move: int) -> tuple[Array, Array, Array]:
        """Return the speeds in mm/s that are compared at the corner after `move`, the durations in s of the rounding,
        and the length in mm that it replaces of each of both moves; each of shape (n, `_SPEEDS`)."""
        change = directions[:, move + 1] - directions[:, move]
        reach = np.minimum(lengths[:, move], lengths[:, move + 1])
        fastest = np.minimum(speeds[:, move], speeds[:, move + 1])
        share = np.linspace(0.0, 1.0, _SPEEDS)
        size = np.sqrt((change * change).sum(axis=1))
        if self.law is CornerLaw.OVERLAP:
            # Duration T = v m with m = max |Δd| / a over the axes. The parabola replaces v T / 2 of each move and
            # passes the corner at the distance v |Δd| T / 8.
            m = (np.abs(change) / np.asarray(self.acceleration_mm_per_s2)).max(axis=1)
            within = 8.0 * self.tolerance_mm / np.maximum(m * size, _TINY)
            v = np.sqrt(np.minimum(within, 2.0 * reach / np.maximum(m, _TINY)))
            v = np.minimum(v, fastest)[:, None] * share
            return v, v * m[:, None], 0.5 * v * v * m[:, None]
        # Turn by the angle 2h: an arc of the radius R = v² / a replaces R tan h of each move, takes 2 h R / v, and
        # passes the corner at the distance R (1 / cos h - 1).
        acceleration = min(self.acceleration_mm_per_s2)
        h = np.arcsin(np.minimum(0.5 * size, 1.0))
        cosine, sine = np.maximum(np.cos(h), _TINY), np.sin(h)
        radius = np.minimum(
            self.tolerance_mm * cosine / np.maximum(1.0 - cosine, _TINY), reach * cosine / np.maximum(sine, _TINY)
        )
        v = np.minimum(np.sqrt(acceleration * radius), fastest)[:, None] * share
        return v, 2.0 * h[:, None] * v / acceleration, v * v / acceleration * (sine / cosine)[:, None]


def _straight_s(length: Array, begin: Array, end: Array, speed: Array, acceleration: Array) -> Array:
    """Return the duration in s of straight moves over `length` in mm, from the speed `begin` to the speed `end` by way
    of at most `speed` in mm/s; inf if the length is negative or too short for this change of speed."""
    possible = (length >= -_COINCIDENT_MM) & (
        np.abs(begin * begin - end * end) <= 2.0 * acceleration * (np.maximum(length, 0.0) + _COINCIDENT_MM)
    )
    length = np.maximum(length, 0.0)
    # Both ramps take (2 u² - v₁² - v₂²) / 2a of the length; at the top speed u of a triangle they take all of it.
    squares = begin * begin + end * end
    top = np.maximum(np.minimum(speed, np.sqrt(acceleration * length + 0.5 * squares)), np.maximum(begin, end))
    cruise = np.maximum(length - (2.0 * top * top - squares) / (2.0 * acceleration), 0.0)
    seconds = (2.0 * top - begin - end) / acceleration + cruise / np.maximum(top, _TINY)
    return np.where(possible, seconds, np.inf)


def _limit_along(directions: Array, per_axis: Sequence[float]) -> Array:
    """Return the largest speed or acceleration along the unit vectors `directions` (..., 3) within the limits of each
    axis."""
    return np.asarray(1.0 / (np.abs(directions) / np.asarray(per_axis)).max(axis=-1))


@dataclass(frozen=True)
class FreeWay:
    """Way of free moves through `stops_mm`, start and end included, with the feed of each move in mm/s. `measuring`
    says whether it belongs to the position set of the run."""

    stops_mm: tuple[Point, ...]
    feeds_mm_per_s: tuple[float, ...]
    measuring: bool


@dataclass(frozen=True)
class RunOfWays:
    """Expected branch of a calibration: its steps that are no free moves, and its ways of free moves.

    The minutes of a part are those of the whole run, or those of the position set alone (`measuring`).
    """

    job: Job
    others: tuple[TimedStep, ...]
    ways: tuple[FreeWay, ...]

    def minutes(self, tolerance_mm: float, law: CornerLaw, *, measuring: bool) -> float:
        """Return the machine minutes if corners are rounded. Each way is then one command."""
        dynamics = blended(self.job, tolerance_mm, law)
        keys = held_out_keys(self.job.held_out)
        seconds = sum(t.seconds for t in self.others if not measuring or phase_of(t.step, keys) == MEASURING)
        for way in self.ways:
            if way.measuring or not measuring:
                moving = dynamics.way_seconds(np.array([way.stops_mm]), np.array(way.feeds_mm_per_s))
                commands = 1 if tolerance_mm > 0.0 else len(way.feeds_mm_per_s)
                seconds += float(moving[0]) + commands * dynamics.command_s
        return seconds / S_PER_MIN

    def corners(self) -> int:
        """Return the number of corners within the ways of the position set."""
        return sum(len(way.stops_mm) - 2 for way in self.ways if way.measuring)


def blended(job: Job, tolerance_mm: float, law: CornerLaw) -> BlendedDynamics:
    model = time_model(job.machine, job.settings.timing)
    return BlendedDynamics(
        model.rapid_mm_per_s, model.acceleration_mm_per_s2, model.command_latency_s, tolerance_mm, law
    )


def for_blending(job: Job, tolerance_mm: float, law: CornerLaw, *, extra_clearance_mm: float = 0.0) -> Job:
    """Return a copy of `job` whose ways are chosen by their duration with rounded corners, at a clearance that is
    larger by `extra_clearance_mm`. A job with plain paths has no choice and is returned unchanged."""
    path_rules = job.rules.retreat.path_rules
    if path_rules is None:
        return job
    chosen = replace(
        path_rules,
        dynamics=blended(job, tolerance_mm, law),
        clearance_mm=path_rules.clearance_mm + extra_clearance_mm,
    )
    return replace(job, rules=replace(job.rules, retreat=replace(job.rules.retreat, path_rules=chosen)))


def walk_ways(job: Job) -> RunOfWays:
    """Return the expected branch of the calibration of `job` with its ways of free moves."""
    keys = held_out_keys(job.held_out)
    others, ways = list[TimedStep](), list[FreeWay]()
    stops, feeds = list[Point](), list[float]()
    measuring = False

    def finish() -> None:
        if feeds:
            ways.append(FreeWay(tuple(stops), tuple(feeds), measuring))
        stops.clear()
        feeds.clear()

    def note(step: Step, motion_s: float, overhead_s: float) -> None:
        nonlocal measuring
        part = phase_of(step, keys) == MEASURING
        if not isinstance(step, MoveTo) or part != measuring:
            finish()
        measuring = part
        if not isinstance(step, MoveTo):
            others.append(TimedStep(step, motion_s, overhead_s))
            return
        if not stops:
            stops.append(actions[ReadPosition](ReadPosition(step.key)))
        stops.append(step.target_mm)
        feeds.append(np.inf if step.feed_mm_per_s is None else step.feed_mm_per_s)

    model = time_model(job.machine, job.settings.timing)
    actions = IdealMachine(job.layout, model, job.start_mm, note).actions()
    Engine(actions).run(expected_plan(calibration_of(job)))
    finish()
    return RunOfWays(job, tuple(others), tuple(ways))


def compute_case(name: str, tolerances_mm: Iterable[float] = TOLERANCES_MM) -> dict[str, float]:
    """Return the figures of the shipped case `name` by their names: the minutes with exact stops and the minutes that
    are saved of them, for each law and tolerance; `set` is the position set alone, `run` the whole run."""
    job = load_case(shipped_case(name).settings)
    exact = walk_ways(job)
    minutes = {part: exact.minutes(0.0, CornerLaw.OVERLAP, measuring=part == "set") for part in ("set", "run")}
    figures = {f"{part} minutes": value for part, value in minutes.items()} | {"corners": float(exact.corners())}
    for law in CornerLaw:
        for tolerance_mm in tolerances_mm:
            other = walk_ways(for_blending(job, tolerance_mm, law))
            proved = walk_ways(for_blending(job, tolerance_mm, law, extra_clearance_mm=tolerance_mm))
            for kind, walked in {"same ways": exact, "best ways": other, "with clearance": proved}.items():
                for part, before in minutes.items():
                    saved = before - walked.minutes(tolerance_mm, law, measuring=part == "set")
                    figures[f"{part} saved, {law.value} {tolerance_mm:g} mm, {kind}"] = saved
    return figures


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blending")
    parser.add_argument("--case", nargs="+", default=["quick"])
    parser.add_argument("--tolerance", type=float, nargs="+", default=list(TOLERANCES_MM), help="in mm")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args(arguments)
    for name in asked.case:
        figures = compute_case(name, asked.tolerance)
        if asked.json:
            print(json.dumps({"case": name} | {key: round(value, 3) for key, value in figures.items()}))
            continue
        print(name)
        for key, value in figures.items():
            print(f"  {key:50s} {value:8.2f}")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
