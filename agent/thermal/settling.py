"""Waiting until the artefact has settled, that is, until its temperature is near enough to 20 °C and changes slowly
enough."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from agent.errors import MeasurementFault, ThermometerFault
from agent.execution.steps import Dwell, Plan, ReadClock, ReadTemperatures, Record, accept_readings
from agent.thermal.readings import Conditions, Thermometers, conditions_of, rate_k_per_h
from twin.units import S_PER_MIN

MIN_TREND_S = 60.0
"""Minimum time span of the readings in s. Over a shorter span, their slope shows the noise of the thermometer, not a
rate of change."""
TREND_WINDOW_S = 600.0
REPEATED_READINGS = 3
"""Number of times that the thermometers are read again if a reading is in doubt."""
REPEATED_AFTER_S = 5.0
"""Time in s before each of these readings. A disturbance of the line, or a conversion that was under way, is over by
then."""
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

    def doubt(self, before: Conditions | None, readings_c: Mapping[str, float], instant_s: float) -> str:
        """Return the reason why `readings_c` at the machine time `instant_s` cannot be used, as text: a thermometer of
        the artefact gives no reading, or the temperature of the artefact has jumped since `before`, such as that of a
        thermometer that has failed or fallen off. The text is empty if the readings can be used."""
        try:
            artefact_c = self.thermometers.artefact_c(readings_c)
        except MeasurementFault as missing:
            return missing.message
        if before is None:
            return ""
        passed_s = instant_s - before.instant_s
        allowed_k = JUMP_K + self.max_rate_k_per_h * passed_s / (60.0 * S_PER_MIN)
        if not abs(artefact_c - before.artefact_c) > allowed_k:  # also without a limit of the rate, at the same instant
            return ""
        return (
            f"the artefact's temperature jumped from {before.artefact_c:.2f} to {artefact_c:.2f} °C within "
            f"{passed_s:.0f} s"
        )


def read_conditions(key: str, rules: SettlingRules, before: Conditions | None) -> Plan[Conditions]:
    """Read the temperatures of artefact and machine, and the run's clock. The machine does not move.

    If the readings are in doubt (`SettlingRules.doubt`), they are not used, and the thermometers are read again. An
    event names them as rejected, so that they are not among the temperatures of the run. The last of these readings is
    a step that raises ThermometerFault if it is in doubt, too. `before` holds the readings used last; it is None if
    there are none.
    """
    first_doubt = ""
    for attempt in range(1 + REPEATED_READINGS):
        here = f"{key}/read-again-{attempt}" if attempt else key
        if attempt:
            yield Dwell(f"{here}/wait", REPEATED_AFTER_S)
        is_last = attempt == REPEATED_READINGS
        require = _requirement(here, rules, before) if is_last else accept_readings
        readings_c = yield ReadTemperatures(f"{here}/temperatures", require)
        instant_s = yield ReadClock(f"{here}/instant")
        doubt = rules.doubt(before, readings_c, instant_s)
        first_doubt = first_doubt or doubt
        if is_last or not doubt:
            break
        yield Record(f"{here}/rejected", "event", {"rejected": f"{here}/temperatures", "reason": doubt})
    found = conditions_of(rules.thermometers, readings_c, instant_s)
    if first_doubt:
        note = f"{first_doubt}; this is not used, since {found.artefact_c:.2f} °C was read again"
        yield Record(f"{here}/replaced", "event", {"note": note, "readings_not_used": attempt})
    return found


def _requirement(
    key: str, rules: SettlingRules, before: Conditions | None
) -> Callable[[Mapping[str, float], float], None]:
    def require(readings_c: Mapping[str, float], instant_s: float) -> None:
        doubt = rules.doubt(before, readings_c, instant_s)
        if doubt:
            raise ThermometerFault(
                f"{doubt}, also when it was read {REPEATED_READINGS} times more",
                hint="check the thermometer of the artefact, its contact and its name in the settings, then resume the "
                "run; it goes on if the thermometer agrees with its former readings",
                step=key,
            )

    return require


def wait_until_settled(key: str, rules: SettlingRules, history: Sequence[Conditions]) -> Plan[Conditions]:
    """Wait, if necessary, until the artefact has settled thermally; return the temperature readings at the end of the
    wait. The machine does not move.

    `history` holds the readings taken with the previous balls, oldest first. Raises MeasurementFault if the
    artefact has not settled at the deadline `rules.deadline_s`.
    """
    trace = [*history, (yield from read_conditions(key, rules, history[-1] if history else None))]
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
        trace.append((yield from read_conditions(here, rules, None)))
    complaint = rules.complaint(trace)
    if complaint:
        raise MeasurementFault(
            f"the artefact has not settled within {rules.deadline_s / S_PER_MIN:g} min: {complaint}",
            hint="leave the artefact on the table until it has the temperature of the machine, keep doors closed and "
            "coolant off, then start again; the limits are in [temperature] of the settings",
        )
    return trace[-1]
