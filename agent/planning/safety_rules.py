"""Safety rules that apply to every measuring plan. For example, every move must stop if the probe trips, and nothing
may move before the permissions have been read.

The preflight checks these rules at each step, because the simulated machine may permit more than the rules.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from agent.errors import PlacementLost, PlanRefused
from agent.execution import steps as s
from agent.execution.states import RunState
from agent.settings.schema import ProcedureSettings, StationSettings
from drivers.errors import NotActiveYet, VolcalError
from drivers.roles import OperatorTask

T = TypeVar("T")

SECONDS_A_MINUTE = 60.0
WRITING_STATES = frozenset({RunState.STAGING, RunState.ACTIVATING, RunState.RESTORING})
"""States of a run in which it writes or activates compensation tables."""


def checked_plan(plan: s.Plan[T], rules: SafetyRules) -> s.Plan[T]:
    """Return a plan that yields the steps of `plan` and checks each step against `rules` before it is executed.

    The result of the returned plan is the result of `plan`. If a step breaks a safety rule, the returned plan raises
    PlanRefused with the key of the step. If the execution of a step raises an error that plans handle themselves, this
    error is raised inside `plan`.
    """
    result: Any = None
    lost: VolcalError | None = None
    try:
        while True:
            try:
                step = plan.send(result) if lost is None else plan.throw(lost)
            except StopIteration as stop:
                conclusion: T = stop.value
                return conclusion
            for complaint in rules.broken_by(step):
                raise PlanRefused(
                    f"preflight: {complaint}", hint="nothing was moved; the plan must change", step=step.key
                )
            result, lost = None, None
            try:
                result = yield step
            except (PlacementLost, NotActiveYet) as expected:
                lost = expected
    finally:
        plan.close()


def safety_rules(procedure: ProcedureSettings, stations: StationSettings, *, carried: bool) -> SafetyRules:
    """Return the rules at the start of a plan. `carried` is True if one mount and its artefact are carried from station
    to station."""
    fastest = max(procedure.touch_feed_mm_per_min, procedure.first_touch_feed_mm_per_min) / SECONDS_A_MINUTE
    if stations.placed_by_hand:
        # The search for an artefact is a touch at the feed of guarded moves, at which the tip stops in its overtravel.
        fastest = max(fastest, procedure.guarded_feed_mm_per_min / SECONDS_A_MINUTE)
    return SafetyRules(fastest, len(stations.places_mm), carried, stations.standing_at)


@dataclass
class SafetyRules:
    """Rules, and the state of a plan after the steps that were checked so far. `stands_at` is the station of the
    carried artefact, or None if it is not known."""

    fastest_mm_per_s: float
    station_count: int
    carried: bool
    stands_at: int | None
    _keys: set[str] = field(default_factory=set)
    _permitted: bool = False
    _probe_seen: bool = False
    _state: RunState = RunState.MEASURING

    def copy(self) -> SafetyRules:
        """Return a copy with which a plan that branches off here can be checked."""
        return replace(self, _keys=set(self._keys))

    def broken_by(self, step: s.Step) -> Iterator[str]:
        if not isinstance(step, (s.Enter, s.Conclude)):
            if step.key in self._keys:
                yield "two steps have the same key, so a run could not be resumed"
            self._keys.add(step.key)
        match step:
            case s.Enter():
                self._state = step.state
            case s.MoveTo():
                yield from self._moved(step)
            case s.TouchTowards():
                yield from self._touched(step)
            case s.HomeAxes():
                yield from self._without_permission("homes the axes")
            case s.CheckPermissions():
                self._permitted = True
            case s.CheckProbe():
                self._probe_seen = True
            case s.AskOperator() if step.request.task is not OperatorTask.CONSENT:
                self.stands_at = step.request.station
            case s.OrientTo() | s.HomeMount():
                yield from self._turned(step.station)
            case s.Dwell() if not 0.0 <= step.duration_s < math.inf:
                yield f"a wait of {step.duration_s} s"
            case s.StageTable() | s.ActivateBank() if self._state not in WRITING_STATES:
                yield "a plan that measures must not write or activate a compensation table"

    def _moved(self, step: s.MoveTo) -> Iterator[str]:
        yield from self._without_permission("moves")
        if not step.guarded:
            yield "an unguarded move: a collision on its path would not stop it"
        if step.feed_mm_per_s is not None and not 0.0 < step.feed_mm_per_s < math.inf:
            yield f"a feed of {step.feed_mm_per_s} mm/s"

    def _touched(self, step: s.TouchTowards) -> Iterator[str]:
        yield from self._without_permission("touches")
        if not self._probe_seen:
            yield "touches before the probe has been checked"
        fastest = self.fastest_mm_per_s
        if not 0.0 < step.feed_mm_per_s <= fastest * (1.0 + 1e-9):
            yield f"a touch at {step.feed_mm_per_s} mm/s, the settings allow up to {fastest:g} mm/s"

    def _turned(self, station: int) -> Iterator[str]:
        yield from self._without_permission("turns the mount")
        count = self.station_count
        if not 1 <= station <= count:
            yield f"the mount at station {station}, there are {count}"
        elif self.carried and self.stands_at not in (None, station):
            yield f"the mount at station {station}, but the artefact stands at station {self.stands_at}"

    def _without_permission(self, what: str) -> Iterator[str]:
        if not self._permitted:
            yield f"{what} before the permissions have been read"
