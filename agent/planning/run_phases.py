"""Phases of a run, as they are shown to the person at the machine while the run goes on.

A phase is a stretch of the plan in which one thing is done: the checks of the probe, the qualification of the stylus,
the measurement of the position set and so on. The phases follow from the keys of the steps. They are finer than those
of `agent.planning.run_minutes`, which account for the minutes of a whole run: the checks before the first position
take minutes, in which the person wants to see which of them is being made.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agent.probing.homing_touches import PREFIX as HOMING_PREFIX
from agent.probing.preparation import PREFIX as PROBE_PREFIX

PREFLIGHT, RETURN = "preflight", "return"
PROBE_CHECK, QUALIFICATION, REVERSAL, HOMING = "probe-check", "qualification", "reversal", "homing"
MEASURING, VERIFICATION = "measuring", "verification"
MOVING_PHASES = (PROBE_CHECK, QUALIFICATION, REVERSAL, HOMING, MEASURING, VERIFICATION)
"""Phases in which the machine moves. The probe check includes the search of the ball on which the checks are made."""

_PARTS = {"qualify": QUALIFICATION, "reversal": REVERSAL}
_VERIFY = "verify"


@dataclass(frozen=True)
class PhaseSpan:
    """Phase `phase` of a plan, from `begin_s` to `end_s` in s of machine time since the run began."""

    phase: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Progress:
    """Progress of a run at the end of one of its steps.

    `fraction` is the completed part of the whole run and `phase_fraction` that of its present phase, both from 0 to 1.
    `minutes_left` and `phase_minutes_left` are the machine times in min until their ends.
    """

    phase: str
    fraction: float
    minutes_left: float
    phase_fraction: float
    phase_minutes_left: float


def phase_spans(timeline: Mapping[str, float]) -> tuple[PhaseSpan, ...]:
    """Return the phases of a plan in the order in which they are carried out. Together they cover its machine time.

    `timeline` maps the key of each step, in the order carried out, to the machine time in s at the end of the step.
    Steps that take no time belong to the phase in which they are.
    """
    spans: list[PhaseSpan] = []
    present: str | None = None
    begin_s = last_s = 0.0
    for key, end_s in timeline.items():
        if end_s <= last_s:
            continue
        phase = _phase_after(key, present)
        if present is not None and phase != present:
            spans.append(PhaseSpan(present, begin_s, last_s))
            begin_s = last_s
        present, last_s = phase, end_s
    return tuple(spans) if present is None else (*spans, PhaseSpan(present, begin_s, last_s))


def _phase_after(key: str, former: str | None) -> str:
    """Return the phase of the step `key`, which follows a step of the phase `former` (None at the beginning)."""
    prefix, *rest = key.split("/")
    if prefix == PROBE_PREFIX:
        own = next((phase for part, phase in _PARTS.items() if part in rest), None)
        # the probe leaves the ball at the end of the last check, which is not another probe check
        return own or (former if former in _PARTS.values() else None) or PROBE_CHECK
    if prefix == HOMING_PREFIX:
        return HOMING
    return VERIFICATION if prefix == _VERIFY else MEASURING
