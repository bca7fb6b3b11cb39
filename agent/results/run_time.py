"""Account of the machine time of a run: the forecast and what the run took, by phase, and the latencies of the
controller that were learned from its steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

_WORDS = {"MoveTo": "a move", "TouchTowards": "a touch", "OrientTo": "a turn"}
_OPERATOR = "AskOperator"
_LEAST_SHARE = 0.01  # of the run; a latency that changes it by less is not worth a word


@dataclass(frozen=True)
class LearnedLatency:
    """Mean time in s that `count` steps of one kind took beyond their motion, and the latency that was forecast."""

    kind: str
    count: int
    forecast_s: float
    learned_s: float

    @property
    def text(self) -> str:
        """The latency in words; a step of another kind than those of the controller is one of the operator."""
        if self.kind == _OPERATOR:
            return f"the operator took {self.learned_s:.0f} s each time instead of {self.forecast_s:.0f}"
        return f"{self.learned_s:.2g} s {_WORDS[self.kind]} instead of {self.forecast_s:.2g}"

    @property
    def excess_s(self) -> float:
        """Time in s that the run took longer because of this latency."""
        return self.count * (self.learned_s - self.forecast_s)


@dataclass(frozen=True)
class RunTime:
    """Forecast and machine time of a run in minutes, in all and by phase, and the latencies of its steps."""

    forecast_minutes: float
    minutes: float
    forecast_by_phase: Mapping[str, float]
    by_phase: Mapping[str, float]
    latencies: tuple[LearnedLatency, ...]

    @property
    def text(self) -> str:
        """Forecast and duration in words, with the latencies that explain the difference."""
        said = f"forecast {self.forecast_minutes:.1f} min, took {self.minutes:.1f}"
        least_s = 60.0 * _LEAST_SHARE * self.forecast_minutes
        telling = [one for one in self.latencies if abs(one.excess_s) > least_s]
        waits = ", ".join(one.text for one in telling if one.kind != _OPERATOR)
        causes = [f"waiting for the controller {waits}"] if waits else []
        causes += [one.text for one in telling if one.kind == _OPERATOR]
        return f"{said}: {'; '.join(causes)}" if causes else said

    @property
    def phases_text(self) -> str:
        """Minutes of each phase that took time, with the forecast in parentheses."""
        rows = [(name, self.by_phase[name], self.forecast_by_phase[name]) for name in self.by_phase]
        return ", ".join(f"{name} {took:.1f} ({said:.1f})" for name, took, said in rows if max(took, said) > 0.0)

    def as_json(self) -> dict[str, object]:
        return {
            "forecast_minutes": round(self.forecast_minutes, 3),
            "minutes": round(self.minutes, 3),
            "forecast_by_phase": {name: round(value, 3) for name, value in self.forecast_by_phase.items()},
            "by_phase": {name: round(value, 3) for name, value in self.by_phase.items()},
            "latencies": [asdict(one) for one in self.latencies],
        }
