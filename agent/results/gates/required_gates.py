"""Requirement that gates are passed, with what to do if they are not, and with the consent of an operator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agent.errors import GateRefused
from agent.figures.numbers import significant
from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import (
    BETTER_CERTIFICATE,
    CERTIFICATE,
    CHANGE,
    COMMON_SCALE,
    FIT,
    GATE_RULES,
    MACHINE_CHANGED,
    MORE_POSITIONS,
    NOISE_STATED,
    PATTERN,
    SCALE_CHECKED,
    SHIFTED,
    STEP,
)


def with_consent(gates: Sequence[Gate]) -> list[Gate]:
    """Return `gates` with the gate `CHANGE` (limit of the machine's change) marked as passed. The operator must have
    consented to the change of the machine."""
    return [
        replace(gate, passed=True, text=f"{gate.text}; consented") if gate.name == CHANGE and not gate.passed else gate
        for gate in gates
    ]


def names_of_failed(gates: Sequence[Gate]) -> tuple[str, ...]:
    return tuple(gate.name for gate in gates if not gate.passed)


def reasons(gates: Sequence[Gate]) -> str:
    """Return a text that names every one of `gates` that was not passed, with its value and its limit."""
    return "; ".join(
        f"{rule.sentence(significant(gate.value), gate.limit)} ({rule.key}; {gate.text})"
        for gate in gates
        if not gate.passed
        for rule in (GATE_RULES[gate.name],)
    )


def require_passed(gates: Sequence[Gate], consent: str = "") -> None:
    """Raise GateRefused if one of `gates` was not passed. The message names every such gate and ends with a remedy and
    `consent`, a sentence on what to do otherwise."""
    if names_of_failed(gates):
        failed = names_of_failed(gates)
        remedies = {
            CERTIFICATE: BETTER_CERTIFICATE,
            STEP: MACHINE_CHANGED,
            PATTERN: SHIFTED,
            FIT: NOISE_STATED,
            COMMON_SCALE: SCALE_CHECKED,
        }
        remedy = next((text for name, text in remedies.items() if name in failed), MORE_POSITIONS)
        raise GateRefused(f"no table was written: {reasons(gates)}", hint=f"{remedy}{consent}")
