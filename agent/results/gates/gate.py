"""Gate: one limit, what was found, and whether it was passed."""

from __future__ import annotations

from dataclasses import dataclass

from agent.figures.numbers import significant
from agent.results.gates.gate_rules import GATE_RULES


@dataclass(frozen=True)
class Gate:
    """Condition that a result must meet before a compensation table is written.

    `passed` is True if `value` meets `limit`. `text` explains the condition and states the unit of `value` and `limit`.
    """

    name: str
    passed: bool
    value: float
    limit: float
    text: str

    @property
    def figures(self) -> str:
        """Value and limit as a text."""
        return f"{significant(self.value)}, required {GATE_RULES[self.name].sign} {significant(self.limit)}"


def gate_below(name: str, value: float, limit: float, text: str) -> Gate:
    """Return the gate that is passed if `value` does not exceed `limit`."""
    return Gate(name, value <= limit, value, limit, text)


def share_of(part: float, whole: float) -> float:
    """Return `part` as a share of `whole`; infinity if that is 0."""
    return part / whole if whole > 0.0 else float("inf")
