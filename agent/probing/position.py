"""Measuring plan of one position. The plan moves the stylus tip clear of the artefact, turns the mount that holds the
artefact, and measures the balls that determine the pose of the artefact: two end balls, and a third ball if the balls
are not close to one line. From their centres it corrects the expected centres of the other balls and measures these
balls. At the end it measures the first ball again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.errors import MeasurementFault, PlacementLost
from agent.execution.steps import Plan, Record
from agent.probing.ball import FittedBall, LostBall, measure_ball
from agent.probing.ball_consistency import BallConsistency
from agent.probing.hand_placement import HandPlacement
from agent.probing.lost_ball import lost_ball_fault
from agent.probing.measured_balls import MeasuredBall
from agent.probing.paths.path_planner import PathPlanner, PlainPathPlanner
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters, Search
from agent.probing.station_change import StationChange
from agent.thermal.position_drift import DriftLimits, judge_drift
from agent.thermal.readings import Conditions
from agent.thermal.settling import SettlingRules, read_conditions, wait_until_settled
from twin.arrays import Array
from twin.artefact.pose_alignment import align_to_end_balls, align_to_third_ball
from twin.artefact.position_set import Position


@dataclass(frozen=True)
class PositionTask:
    """Position to be measured.

    `predicted_mm` (N, 3) holds the expected axis positions of all N balls. `reachable` (N,) is True for balls that the
    probe can reach. `located` is True if a ball has been found at `station` since the artefact was put there.
    """

    key: str
    index: int
    station: int
    azimuth_deg: float
    elevation_deg: float
    predicted_mm: Array
    reachable: NDArray[np.bool_]
    located: bool = True

    @property
    def balls(self) -> list[int]:
        return [int(i) for i in np.flatnonzero(self.reachable)]


@dataclass(frozen=True)
class MeasuredPosition:
    """Result of the measurement of one position.

    `lost` is the number of balls that could not be measured. `again` is the repeated measurement of the position's
    first ball; it is None if that ball was not repeated or was lost in the repetition. `drift_mm` (3,) is the
    displacement of the first ball between its two measurements; it is NaN without a repetition. `last_mm` (3,) contains
    the axis positions of the centre of the ball at which the probe was last.
    """

    balls: tuple[MeasuredBall, ...]
    lost: int
    touches: int
    drift_mm: Array
    last_mm: Array
    again: MeasuredBall | None = None

    @property
    def position(self) -> Position:
        """Measured position, without a choice of its balls."""
        one = self.balls[0]
        return Position(one.station, one.azimuth_deg, one.elevation_deg)

    @property
    def conditions(self) -> tuple[Conditions, ...]:
        """Temperature readings at the balls."""
        return tuple(ball.conditions for ball in self.balls)

    @property
    def all_balls(self) -> tuple[MeasuredBall, ...]:
        """All measured balls of the position. If the first ball was measured again, its repeated measurement is the
        last element."""
        return self.balls if self.again is None else (*self.balls, self.again)

    @property
    def ball_numbers(self) -> list[int]:
        return [ball.ball for ball in self.balls]

    @property
    def centres_mm(self) -> Array:
        """Axis positions (n, 3), as displayed by the controller, of the n ball centres, in the order of `balls`."""
        return np.array([ball.found.centre_mm for ball in self.balls])


@dataclass(frozen=True)
class PositionRules:
    """Rules of the measurement of a position. `placement` has the rules for an artefact that is placed by hand; it is
    None if a mount holds the artefact. `consistency` checks balls that are touched too few times for a form error of
    their own against the other balls of the position; it is None if every ball is checked on its own.
    `repeat_first_ball` is True if the first ball is measured again at the end, which shows a drift within the position.
    """

    probing: ProbingParameters
    retreat: Retreat
    drift: DriftLimits
    settling: SettlingRules = field(default_factory=SettlingRules)
    change: StationChange = field(default_factory=StationChange)
    placement: HandPlacement | None = None
    consistency: BallConsistency | None = None
    repeat_first_ball: bool = True


def measure_position(
    task: PositionTask,
    here: Array,
    rules: PositionRules,
    before: Sequence[Conditions] = (),
    planner: PathPlanner | None = None,
) -> Plan[MeasuredPosition]:
    """Measure every reachable ball of `task`. If `planner` is None, the tip moves on plain paths and ends at the
    retreat plane, which no part of the artefact or mount reaches.

    `here` (3,) holds the axis positions at the start. The balls that determine the pose of the artefact are measured
    first, with long search distances: two end balls, and a third ball if the balls are not close to one line. The
    expected centres of the other balls are then corrected from the centres found. The first ball is measured again at
    the end to find the drift during the position. `before` holds the temperature readings of the previous position. If
    the readings show that the artefact has not settled thermally, the measurement starts only after it has settled.
    """
    own = planner or PlainPathPlanner(rules.retreat, rules.probing)
    sequence = own.sequence(task)
    first, last, third = sequence.first, sequence.last, sequence.third
    yield from own.turn(task, here)
    settled = yield from wait_until_settled(task.key, rules.settling, before)
    measuring = _Measuring(task, rules, own, settled)
    yield from own.enter(task, first)
    found_first = yield from measuring.pose_ball(
        first, task.predicted_mm, rules.probing.wide_search if task.located else rules.probing.locating_search
    )
    found_last = yield from measuring.pose_ball(last, task.predicted_mm, rules.probing.wide_search)
    aligned = align_to_end_balls(task.predicted_mm, first, last, found_first.centre_mm, found_last.centre_mm)
    if third is not None:
        found_third = yield from measuring.pose_ball(third, aligned, rules.probing.wide_search)
        aligned = align_to_third_ball(aligned, first, last, third, found_third.centre_mm)
    own.align(aligned)
    for ball in sequence.others:
        yield from measuring.ball(ball, aligned[ball])
    found_first = yield from measuring.check_consistency(first, found_first)
    drift = yield from measuring.drift(first, found_first, rules.drift)
    if planner is None:
        yield from own.leave(task.key, measuring.last_mm)
    return MeasuredPosition(
        tuple(measuring.found), measuring.lost, measuring.touches, drift, measuring.last_mm, measuring.again
    )


class _Measuring:
    """State of the measurement of one position: the balls found, the number of lost balls, and the number of
    touches."""

    def __init__(self, task: PositionTask, rules: PositionRules, planner: PathPlanner, conditions: Conditions) -> None:
        self._task = task
        self._probing = rules.probing
        self._planner = planner
        self._by_hand = rules.placement is not None
        self._settling = rules.settling
        self._conditions = conditions
        self._consistency = rules.consistency
        self._repeats_first = rules.repeat_first_ball
        self._search = rules.probing.narrow_search
        self.last_mm = task.predicted_mm[task.balls[0]]
        self.found: list[MeasuredBall] = []
        self.again: MeasuredBall | None = None
        self.lost = 0
        self.touches = 0

    def pose_ball(self, ball: int, predicted: Array, search: Search) -> Plan[FittedBall]:
        """Measure a ball that determines the pose of the artefact, at its predicted centre in `predicted` (N, 3).
        Raises MeasurementFault if it is lost, or PlacementLost if the artefact is placed by hand."""
        result = yield from self.ball(ball, predicted[ball], search)
        if isinstance(result, LostBall) and self._by_hand:
            raise PlacementLost(
                f"ball {ball} could not be measured after the artefact had been located: {result.reason}",
                hint="clean the ball, and check that the artefact stands firmly",
                step=self._key(ball),
            )
        if isinstance(result, LostBall):
            raise (yield from lost_ball_fault(self._key(ball), f"end ball {ball}", result, self._probing))
        return result

    def ball(self, ball: int, predicted: Array, search: Search | None = None) -> Plan[FittedBall | LostBall]:
        """Measure one ball. It is recorded in the journal at once, unless it can be checked only together with the
        other balls of the position."""
        key = self._key(ball)
        result = yield from self._approach_and_measure(key, ball, predicted, search or self._search)
        if search is None:
            self._search = self._search_after(result, predicted)
        if isinstance(result, LostBall):
            yield from self._lose(ball, result.reason)
            return result
        measured = yield from self._measured(key, ball, result)
        self.found.append(measured)
        if self._consistency is None:
            yield Record(f"{key}/centre", "ball", measured.record(key))
        return result

    def _search_after(self, result: FittedBall | LostBall, predicted: Array) -> Search:
        """Return the search for the ball after this one. If this ball was lost or is not where the balls before place
        it, the artefact may have been moved, and with it the next ball: that one is located first."""
        probing = self._probing
        as_expected = (
            isinstance(result, FittedBall)
            and float(np.linalg.norm(result.centre_mm - predicted)) <= probing.recentre_mm
        )
        return probing.narrow_search if as_expected else probing.locating_search

    def check_consistency(self, first: int, found_first: FittedBall) -> Plan[FittedBall]:
        """Measure the balls that do not fit the others once more, and give those up that still do not fit. Return the
        first ball as it was measured last.

        The probe does not leave the position before, so that a false trip costs seconds. A particle on a ball, or a
        ball that is loose on its holder, does not disappear.
        """
        check = self._consistency
        if check is None:
            return found_first
        doubtful = check.inconsistent(self.found)
        for one in doubtful:
            key = f"{self._key(one.ball)}/once-more"
            yield Record(f"{key}/reason", "event", {"ball": one.ball, "reason": one.text, "then": "repeat the ball"})
            place = [ball.ball for ball in self.found].index(one.ball)
            predicted = self.found[place].found.centre_mm
            result = yield from self._approach_and_measure(key, one.ball, predicted, self._search)
            self._search = self._search_after(result, predicted)
            if isinstance(result, LostBall):
                del self.found[place]
                yield from self._lose(one.ball, result.reason)
            else:
                self.found[place] = yield from self._measured(key, one.ball, result)
        for one in check.inconsistent(self.found) if doubtful else ():
            if self._probing.stop_on_failure:
                raise MeasurementFault(
                    f"ball {one.ball} does not fit the other balls of its position: {one.text}",
                    hint="clean the ball and the stylus, and check that the ball is firm on its holder",
                    step=self._key(one.ball),
                )
            self.found = [ball for ball in self.found if ball.ball != one.ball]
            yield from self._lose(one.ball, one.text)
        for measured in self.found:
            key = self._key(measured.ball)
            yield Record(f"{key}/centre", "ball", measured.record(key))
        return next((ball.found for ball in self.found if ball.ball == first), found_first)

    def _lose(self, ball: int, reason: str) -> Plan[None]:
        self.lost += 1
        yield Record(f"{self._key(ball)}/lost", "event", {"ball": ball, "reason": reason})

    def _key(self, ball: int) -> str:
        return f"{self._task.key}/ball-{ball:02d}"

    def drift(self, first: int, found: FittedBall, limits: DriftLimits) -> Plan[Array]:
        """Measure the first ball again; return its apparent displacement (3,) in mm, NaN if it was lost
        or is not to be repeated."""
        if not self._repeats_first or all(ball.ball != first for ball in self.found):
            return np.full(3, np.nan)
        key = f"{self._key(first)}/again"
        again = yield from self._approach_and_measure(key, first, found.centre_mm, self._search)
        if isinstance(again, LostBall):
            yield Record(f"{key}/lost", "event", {"ball": first, "reason": again.reason})
            return np.full(3, np.nan)
        self.again = yield from self._measured(key, first, again)
        drift: Array = again.centre_mm - found.centre_mm
        yield from judge_drift(key, drift, limits)
        return drift

    def _measured(self, key: str, ball: int, found: FittedBall) -> Plan[MeasuredBall]:
        self._conditions = conditions = yield from read_conditions(key, self._settling, self._conditions)
        task = self._task
        return MeasuredBall(task.index, task.station, task.azimuth_deg, task.elevation_deg, ball, found, conditions)

    def _approach_and_measure(
        self, key: str, ball: int, predicted: Array, search: Search
    ) -> Plan[FittedBall | LostBall]:
        yield from self._planner.to_ball(key, predicted)
        result = yield from measure_ball(key, predicted, self._probing, search, self._planner.touch_path(ball))
        self.touches += result.touches
        self.last_mm = result.centre_mm if isinstance(result, FittedBall) else predicted
        yield from self._planner.from_ball(key, self.last_mm)
        return result
