"""Forecast of a run that goes on. The latencies of the controller are learned from the first steps of the run, and the
minutes that are left follow them, for the whole run and for its present phase.

The forecast of the preflight has two parts: the motions, which follow from the limits of the machine, and a latency for
each command. The latencies are those of the settings until enough commands of a kind have been carried out, and then
the mean of what these took beyond their motion.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from agent.execution.steps import HomeAxes, Step
from agent.planning.branch_walk import Branch
from agent.planning.latency_fit import CARRY, KINDS, MOVE, TOUCH, TURN, LatencyRecord, latencies_of
from agent.planning.preflight import PreflightResult
from agent.planning.run_minutes import PHASES, held_out_keys, phase_of
from agent.planning.run_phases import PhaseSpan, Progress, phase_spans
from agent.planning.time_model import TimeModel, takes_time
from agent.results.run_time import LearnedLatency, RunTime
from twin.artefact.position_set import Position
from twin.units import S_PER_MIN

ENOUGH = {MOVE: 50, TOUCH: 20, TURN: 2, CARRY: 1}
"""Number of steps of each kind from which a latency is taken as learned; about those of the first position."""


class RunForecast:
    """Forecast of a run, corrected by the steps that were carried out. `model` is the time model of the preflight.

    The forecast is that of the expected branch of the plan. If the run takes another branch, it is followed from its
    first step that the expected branch does not have.
    """

    def __init__(self, preflight: PreflightResult, model: TimeModel, held_out: tuple[Position, ...]) -> None:
        self._preflight = preflight
        self._held_out = held_out_keys(held_out)
        self._given_s = latencies_of(model)
        self._record = LatencyRecord(model)
        self._spent_s = dict.fromkeys(PHASES, 0.0)
        self._forecast_s = dict.fromkeys(PHASES, 0.0)
        for timed in preflight.steps:
            self._forecast_s[phase_of(timed.step, self._held_out)] += timed.seconds
        self._last_key = ""
        self._follow(preflight.expected)

    def _follow(self, branch: Branch) -> None:
        self._branch = branch
        self._spans = phase_spans(branch.timeline)
        self._counts: dict[float, tuple[int, ...]] = {}
        self._ends_s: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for timed in branch.steps:
            if takes_time(timed.step):
                self._ends_s[type(timed.step).__name__].append(branch.timeline[timed.step.key])

    def observe(self, step: Step, result: object, took_s: float) -> None:
        """Take note of a step that took `took_s` in s."""
        if takes_time(step) or isinstance(step, HomeAxes):
            self._spent_s[phase_of(step, self._held_out)] += took_s
        self._record.observe(step, result, took_s)

    def _latency_s(self, kind: str) -> float:
        return self._record.mean_s(kind) if self._record.count(kind) >= ENOUGH[kind] else self._given_s[kind]

    def at_start(self) -> Progress | None:
        """Return the progress before the first step; None if nothing is measured."""
        return self._progress_at(0.0)

    def progress(self, key: str) -> Progress | None:
        """Return the progress at the end of the step `key` with the present latencies; None if the preflight had no
        such step."""
        if key not in self._branch.timeline:
            taken = next((one for one in self._preflight.ends if self._continues(one, key)), None)
            if taken is None:
                return None
            self._follow(taken)
        self._last_key = key
        return self._progress_at(self._branch.timeline[key])

    def _continues(self, branch: Branch, key: str) -> bool:
        """Return True if the step `key` of `branch` can follow the last known step."""
        return key in branch.timeline and (not self._last_key or self._last_key in branch.timeline)

    def _progress_at(self, at_s: float) -> Progress | None:
        span = self._span_at(at_s)
        if span is None:
            return None
        learned_s = [self._latency_s(kind) - self._given_s[kind] for kind in KINDS]
        done_s, whole_s = self._until_s(at_s, learned_s), self._until_s(self._branch.machine_seconds, learned_s)
        begin_s, end_s = self._until_s(span.begin_s, learned_s), self._until_s(span.end_s, learned_s)
        return Progress(
            span.phase,
            _fraction(done_s, whole_s),
            max(0.0, whole_s - done_s) / S_PER_MIN,
            _fraction(done_s - begin_s, end_s - begin_s),
            max(0.0, end_s - done_s) / S_PER_MIN,
        )

    def _span_at(self, at_s: float) -> PhaseSpan | None:
        """Return the phase that goes on at `at_s`, or the last one if all have ended; None if there is none."""
        number = bisect_right(self._spans, at_s, key=lambda span: span.end_s)
        return self._spans[min(number, len(self._spans) - 1)] if self._spans else None

    def _until_s(self, at_s: float, learned_s: Sequence[float]) -> float:
        """Return the machine time in s up to the time `at_s` of the preflight. `learned_s` is what the latency of each
        kind of step has become longer in s, in the order of `KINDS`."""
        spent_s = at_s
        for count, longer_s in zip(self._counts_until(at_s), learned_s, strict=True):
            spent_s += count * longer_s
        return max(0.0, spent_s)

    def _counts_until(self, at_s: float) -> tuple[int, ...]:
        """Return the number of steps of each kind that end up to the time `at_s` of the preflight. The numbers at the
        ends of the branch and of its phases are wanted after every step."""
        if at_s not in self._counts:
            self._counts[at_s] = tuple(bisect_right(ends_s, at_s) for ends_s in self._ends_s.values())
        return self._counts[at_s]

    def run_time(self, minutes: float) -> RunTime:
        """Return the account of the time of the run, which took `minutes` of machine time."""
        learned = tuple(
            LearnedLatency(kind, self._record.count(kind), self._given_s[kind], self._record.mean_s(kind))
            for kind in KINDS
            if self._record.count(kind)
        )
        return RunTime(
            self._preflight.machine_minutes,
            minutes,
            {phase: seconds / S_PER_MIN for phase, seconds in self._forecast_s.items()},
            {phase: seconds / S_PER_MIN for phase, seconds in self._spent_s.items()},
            learned,
        )


def _fraction(done_s: float, whole_s: float) -> float:
    return min(max(done_s / whole_s, 0.0), 1.0) if whole_s > 0.0 else 1.0
