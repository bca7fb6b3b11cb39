"""Forecast of a run that goes on. The latencies of the controller are learned from the first steps of the run, and the
minutes that are left follow them.

The forecast of the preflight has two parts: the motions, which follow from the limits of the machine, and a latency for
each command. The latencies are those of the settings until enough commands of a kind have been carried out, and then
the mean of what these took beyond their motion.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping

from agent.execution.steps import HomeAxes, Step
from agent.planning.latency_fit import CARRY, KINDS, MOVE, TOUCH, TURN, LatencyRecord, latencies_of
from agent.planning.preflight import PreflightResult
from agent.planning.run_minutes import PHASES, held_out_keys, phase_of
from agent.planning.time_model import TimeModel, takes_time
from agent.results.run_time import LearnedLatency, RunTime
from twin.artefact.position_set import Position
from twin.units import S_PER_MIN

ENOUGH = {MOVE: 50, TOUCH: 20, TURN: 2, CARRY: 1}
"""Number of steps of each kind from which a latency is taken as learned; about those of the first position."""


class RunForecast:
    """Forecast of a run, corrected by the steps that were carried out. `model` is the time model of the preflight."""

    def __init__(self, preflight: PreflightResult, model: TimeModel, held_out: tuple[Position, ...]) -> None:
        self._preflight = preflight
        self._held_out = held_out_keys(held_out)
        self._given_s = latencies_of(model)
        self._record = LatencyRecord(model)
        self._spent_s = dict.fromkeys(PHASES, 0.0)
        self._forecast_s = dict.fromkeys(PHASES, 0.0)
        self._ends_s: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for timed in preflight.steps:
            self._forecast_s[phase_of(timed.step, self._held_out)] += timed.seconds
            if takes_time(timed.step):
                self._ends_s[type(timed.step).__name__].append(preflight.timeline[timed.step.key])

    def observe(self, step: Step, result: object, took_s: float) -> None:
        """Take note of a step that took `took_s` in s."""
        if takes_time(step) or isinstance(step, HomeAxes):
            self._spent_s[phase_of(step, self._held_out)] += took_s
        self._record.observe(step, result, took_s)

    @property
    def latencies_s(self) -> Mapping[str, float]:
        """Latency in s of each kind of step: the learned one, or the one of the settings."""
        learned = {kind: self._record.mean_s(kind) for kind in KINDS if self._record.count(kind) >= ENOUGH[kind]}
        return {**self._given_s, **learned}

    def done_s(self, key: str) -> float | None:
        """Return the machine time in s up to the end of the step `key` with the present latencies; None if the
        preflight had no such step."""
        return self._split_s(key, done=True)

    def left_s(self, key: str) -> float | None:
        """Return the machine time in s that is left after the step `key`; None if the preflight had no such step."""
        return self._split_s(key, done=False)

    def _split_s(self, key: str, *, done: bool) -> float | None:
        at_s = self._preflight.timeline.get(key)
        if at_s is None:
            return None
        spent_s = at_s if done else self._preflight.machine_seconds - at_s
        for kind, latency_s in self.latencies_s.items():
            ends_s = self._ends_s[kind]
            before = bisect_right(ends_s, at_s)
            spent_s += (before if done else len(ends_s) - before) * (latency_s - self._given_s[kind])
        return max(0.0, spent_s)

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
