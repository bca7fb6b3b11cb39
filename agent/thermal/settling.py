"""Waiting until the artefact has settled, that is, until its temperature is near enough to 20 °C and changes slowly
enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from agent.errors import MeasurementFault
from agent.execution.steps import Dwell, Plan, Record
from agent.thermal.readings import Conditions, Thermometers, rate_k_per_h, read_conditions
from twin.units import S_PER_MIN

MIN_TREND_S = 60.0
"""Minimum time span of the readings in s. Over a shorter span, their slope shows the noise of the thermometer, not a
rate of change."""
TREND_WINDOW_S = 600.0
JUMP_K = 1.0
"""Change in K between two readings, beyond the permitted rate, that no artefact makes: what shows it is not the
temperature of the artefact."""


@dataclass(frozen=True)
class SettlingRules:
    """Rules of the wait for a settled artefact.

    `max_rate_k_per_h` limits the rate at which the artefact's temperature changes, and `max_departure_k` limits its
    difference from 20 °C. During the wait, the temperature is read at intervals of `poll_interval_s`. The wait lasts
    `deadline_s` at most.
    """

    thermometers: Thermometers = field(default_factory=Thermometers)
    max_rate_k_per_h: float = math.inf
    max_departure_k: float = math.inf
    poll_interval_s: float = 60.0
    deadline_s: float = 3600.0

    def complaint(self, trace: Sequence[Conditions]) -> str:
        """Return the reason why the artefact has not settled thermally at the last reading of `trace`, as text. The
        text is empty if the artefact has settled. `trace` holds readings in the order of time."""
        now = trace[-1]
        if abs(now.departure_k) > self.max_departure_k:
            return (
                f"the artefact has {now.artefact_c:.2f} °C, {abs(now.departure_k):.2f} K from 20 °C, "
                f"allowed {self.max_departure_k:g} K"
            )
        recent = [one for one in trace if now.instant_s - one.instant_s <= TREND_WINDOW_S]
        if now.instant_s - recent[0].instant_s < MIN_TREND_S:
            return ""
        rate = rate_k_per_h(recent)
        if rate is not None and abs(rate) > self.max_rate_k_per_h:
            return f"the artefact changes by {rate:+.1f} K/h, allowed {self.max_rate_k_per_h:g} K/h"
        return ""

    def require_no_jump(self, key: str, before: Conditions, now: Conditions) -> None:
        """Raise MeasurementFault, which names the step `key`, if the temperature of the artefact has jumped between two
        readings, such as that of a thermometer that has failed or fallen off."""
        allowed_k = JUMP_K + self.max_rate_k_per_h * (now.instant_s - before.instant_s) / (60.0 * S_PER_MIN)
        if abs(now.artefact_c - before.artefact_c) > allowed_k:
            raise MeasurementFault(
                f"the artefact's temperature jumped from {before.artefact_c:.2f} to {now.artefact_c:.2f} °C within "
                f"{now.instant_s - before.instant_s:.0f} s",
                hint="check the thermometer of the artefact and its contact, then start again",
                step=key,
            )


def wait_until_settled(key: str, rules: SettlingRules, history: Sequence[Conditions]) -> Plan[Conditions]:
    """Wait, if necessary, until the artefact has settled thermally; return the temperature readings at the end of the
    wait. The machine does not move.

    `history` holds the readings taken with the previous balls, oldest first. Raises MeasurementFault if the
    temperature of the artefact has jumped, or if it has not settled at the deadline `rules.deadline_s`.
    """
    trace = [*history, (yield from read_conditions(key, rules.thermometers))]
    if history:
        rules.require_no_jump(key, history[-1], trace[-1])
    attempts = math.ceil(rules.deadline_s / rules.poll_interval_s)
    for attempt in range(1, attempts + 1):
        complaint = rules.complaint(trace)
        if not complaint:
            return trace[-1]
        here = f"{key}/settle-{attempt}"
        if attempt == 1:
            note = f"waiting until the artefact has settled: {complaint}"
            yield Record(f"{here}/held", "event", {"note": note, "deadline_minutes": rules.deadline_s / S_PER_MIN})
        yield Dwell(f"{here}/wait", rules.poll_interval_s)
        trace.append((yield from read_conditions(here, rules.thermometers)))
    complaint = rules.complaint(trace)
    if complaint:
        raise MeasurementFault(
            f"the artefact has not settled within {rules.deadline_s / S_PER_MIN:g} min: {complaint}",
            hint="leave the artefact on the table until it has the temperature of the machine, keep doors closed and "
            "coolant off, then start again; the limits are in [temperature] of the settings",
        )
    return trace[-1]
