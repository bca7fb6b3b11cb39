"""Comparison of the time model with a finished run.

The comparison gives the predicted and the observed times of the steps, and latencies fitted to the observed times.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, cast

from agent.execution.journal_rows import StepRow
from agent.execution.steps import AskOperator, MoveTo, OrientTo, Point, ReadPosition, Step, TouchTowards
from agent.planning.time_model import TimeModel
from drivers.roles import OperatorTask, Touch
from twin.collision.motion_law import straight_path
from twin.units import S_PER_MIN

MOVE, TOUCH, TURN, CARRY = "MoveTo", "TouchTowards", "OrientTo", "AskOperator"
KINDS = (MOVE, TOUCH, TURN, CARRY)
"""Kinds of steps that take time, by their names in the journal."""

_Angles: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class ObservedStep:
    """Step of a finished run, with times in s.

    `motion_s` is the time of the motion alone, computed with the motion law of the axes or the mount. `observed_s` is
    the whole time that the step took in the run.
    """

    kind: str
    motion_s: float
    observed_s: float


@dataclass(frozen=True)
class StepKindTiming:
    """Times of all steps of one kind in a finished run, in seconds.

    `observed_s` and `predicted_s` are the sums of the observed and of the predicted times of the steps. `latency_s` is
    the latency of one step according to the settings, and `suggested_latency_s` is the fitted latency. The latency is
    the time of a step minus the time of its motion; for an AskOperator step, it is the whole time. `rest_s` is the rms
    of the differences between observed and predicted times with the fitted latency.
    """

    kind: str
    count: int
    observed_s: float
    predicted_s: float
    latency_s: float
    suggested_latency_s: float
    rest_s: float


def observed_steps(steps: Iterable[StepRow], model: TimeModel) -> list[ObservedStep]:
    """Return the steps of a run with their observed times and the times of their motion according to the time model
    `model`.

    The positions of the axes and the angles of the mount, from which the motion times follow, are tracked from step to
    step. A step is left out if it starts from an unknown position or did not end.
    """
    replay = _Replay(model)
    return [observed for step in steps if (observed := replay.observed(step)) is not None]


def refit(model: TimeModel, observed: Sequence[ObservedStep]) -> TimeModel:
    """Return a copy of the time model `model` with a fitted latency for each kind of step in `observed`.

    Motion times and all other latencies are unchanged. The latency of a step is its time minus the time of its motion.
    The fitted latency is the mean over the steps of one kind, which is the least-squares estimate of a constant. A
    negative mean is replaced by zero; it occurs if the machine is faster than its machine file states.
    """
    return replace(
        model,
        command_latency_s=_fitted(MOVE, model.command_latency_s, observed),
        touch_latency_s=_fitted(TOUCH, model.touch_latency_s, observed),
        turn_latency_s=_fitted(TURN, model.turn_latency_s, observed),
        carrying_s=_fitted(CARRY, model.carrying_s, observed),
    )


def _fitted(kind: str, given_s: float, observed: Sequence[ObservedStep]) -> float:
    beyond = [step.observed_s - step.motion_s for step in observed if step.kind == kind]
    return max(0.0, math.fsum(beyond) / len(beyond)) if beyond else given_s


def step_kind_timings(model: TimeModel, observed: Sequence[ObservedStep]) -> list[StepKindTiming]:
    """Return, for every kind of step in `observed`, the observed times and the times predicted by the time model."""
    given, fitted = latencies_of(model), latencies_of(refit(model, observed))
    table = []
    for kind in KINDS:
        of_kind = [step for step in observed if step.kind == kind]
        if of_kind:
            table.append(_summary(kind, of_kind, given[kind], fitted[kind]))
    return table


def suggested_settings(model: TimeModel) -> dict[str, float]:
    """Return the latencies of the time model `model` as a mapping from their keys in the section `timing` of the
    settings.
    """
    return {
        "command_latency_s": round(model.command_latency_s, 4),
        "touch_latency_s": round(model.touch_latency_s, 4),
        "turn_latency_s": round(model.turn_latency_s, 4),
        "relocation_minutes": round(model.carrying_s / S_PER_MIN, 2),
    }


def latencies_of(model: TimeModel) -> dict[str, float]:
    """Return the latency in s of each kind of step according to the time model `model`."""
    return {
        MOVE: model.command_latency_s,
        TOUCH: model.touch_latency_s,
        TURN: model.turn_latency_s,
        CARRY: model.carrying_s,
    }


def _summary(kind: str, steps: Sequence[ObservedStep], latency_s: float, suggested_s: float) -> StepKindTiming:
    rest = [step.observed_s - step.motion_s - suggested_s for step in steps]
    return StepKindTiming(
        kind=kind,
        count=len(steps),
        observed_s=math.fsum(step.observed_s for step in steps),
        predicted_s=math.fsum(step.motion_s + latency_s for step in steps),
        latency_s=latency_s,
        suggested_latency_s=suggested_s,
        rest_s=math.sqrt(math.fsum(value * value for value in rest) / len(rest)),
    )


class LatencyRecord:
    """Running mean of what the steps of each kind took beyond their motion, kept while a run is carried out."""

    def __init__(self, model: TimeModel) -> None:
        self._replay = _Replay(model)
        self._beyond_s = dict.fromkeys(KINDS, 0.0)
        self._counts = dict.fromkeys(KINDS, 0)

    def observe(self, step: Step, result: object, took_s: float) -> None:
        """Take note of a step that took `took_s` in s. Steps from an unknown position do not count, nor do kinds of
        steps that take no time."""
        motion_s = self._replay.motion_s(step, result)
        if motion_s is not None:
            kind = type(step).__name__
            self._beyond_s[kind] += took_s - motion_s
            self._counts[kind] += 1

    def count(self, kind: str) -> int:
        return self._counts[kind]

    def mean_s(self, kind: str) -> float:
        """Return the mean of `kind` in s; negative means are zero, as in `refit`, and so is the mean of no steps."""
        return max(0.0, self._beyond_s[kind] / self._counts[kind]) if self._counts[kind] else 0.0


class _Replay:
    """Tracked positions of axes and mount through the steps of a run; None while they are unknown."""

    def __init__(self, model: TimeModel) -> None:
        self._model = model
        self._at_mm: Point | None = None
        self._turned_deg: _Angles | None = None

    def observed(self, step: StepRow) -> ObservedStep | None:
        if step.finished_s is None:
            self._at_mm = self._turned_deg = None
            return None
        motion_s = self._stored_motion_s(step)
        return None if motion_s is None else ObservedStep(step.kind, motion_s, step.finished_s - step.begun_s)

    def motion_s(self, step: Step, result: object) -> float | None:
        """Return the time in s of the motion alone of a step that has ended with `result`, None if unknown, and store
        the position reached. The numbers are those of its row in the journal."""
        match step:
            case ReadPosition():
                self._at_mm = _triple(cast(Sequence[float], result))
            case MoveTo():
                return self._move_s(step.target_mm, step.feed_mm_per_s)
            case TouchTowards():
                latched = result.position_mm if isinstance(result, Touch) else None
                return self._touch_s(step.target_mm, step.feed_mm_per_s, latched)
            case OrientTo():
                return self._turn_s((step.azimuth_deg, step.elevation_deg))
            case AskOperator() if step.request.task is not OperatorTask.CONSENT:
                return 0.0
        return None

    def _stored_motion_s(self, step: StepRow) -> float | None:
        """Return what `motion_s` returns, for a step of the journal."""
        match step.kind:
            case "ReadPosition":
                self._at_mm = _triple(step.result)
            case "MoveTo":
                return self._move_s(_triple(step.detail["target_mm"]), step.detail["feed_mm_per_s"])
            case "TouchTowards":
                target_mm, feed_mm_per_s = _triple(step.detail["target_mm"]), step.detail["feed_mm_per_s"]
                return self._touch_s(target_mm, feed_mm_per_s, step.result.get("touch"))
            case "OrientTo":
                return self._turn_s((step.detail["azimuth_deg"], step.detail["elevation_deg"]))
            case "AskOperator" if step.detail["request"]["task"] != OperatorTask.CONSENT.value:
                return 0.0
        return None

    def _move_s(self, target_mm: Point, feed_mm_per_s: float | None) -> float | None:
        start_mm, self._at_mm = self._at_mm, target_mm
        return None if start_mm is None else self._model.move_s(start_mm, target_mm, feed_mm_per_s)

    def _touch_s(self, target_mm: Point, feed_mm_per_s: float, latched_mm: Sequence[float] | None) -> float | None:
        start_mm, self._at_mm = self._at_mm, None
        if start_mm is None:
            return None
        trip_mm = None if latched_mm is None else math.dist(start_mm, latched_mm)
        path = straight_path(start_mm, target_mm)
        motion_s, self._at_mm = self._model.touch_s(path, feed_mm_per_s, trip_mm)
        return motion_s

    def _turn_s(self, target_deg: _Angles) -> float | None:
        start_deg, self._turned_deg = self._turned_deg, target_deg
        return None if start_deg is None else self._model.turn_s(start_deg, target_deg)


def _triple(values: Sequence[float]) -> Point:
    x, y, z = values
    return x, y, z
