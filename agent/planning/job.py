"""Job of a run: the calibration prepared from the settings and from the files that the settings name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from agent.execution.steps import Plan, RunPlan
from agent.planning.measuring_order import OrderOptimiser
from agent.planning.time_model import time_model
from agent.probing.measured_balls import MeasuredBall, numbered_together
from agent.probing.position import PositionRules
from agent.probing.preparation import Preparation, PreparationResult, prepare_probe
from agent.probing.repeated_positions import RepeatRules
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, by_station
from agent.settings.schema import GateSettings, Settings, TimingSettings
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.artefact.touch_pattern import centre_covariance
from twin.collision.geometry import Point
from twin.collision.measuring_layout import MeasuringLayout
from twin.design.measurement_setup import AS_STATED
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.identification.hidden_step import HiddenStep, StepVisibility
from twin.machine.machine_description import MachineDescription


class HeldOutChoice(Protocol):
    """Held-out positions of a job. They may be computed when they are first read."""

    @property
    def positions(self) -> tuple[Position, ...]: ...


@dataclass(frozen=True)
class KnownHeldOut:
    """Held-out positions that are known from the beginning."""

    positions: tuple[Position, ...] = ()


@dataclass(frozen=True)
class Job:
    """Prepared calibration, which can be listed, checked by a preflight and carried out.

    `positions` are measured to estimate the errors of the machine. The positions `held_out` are never used for this
    estimate; they verify it. They are chosen when they are first read, because the choice takes much longer than the
    rest of the preparation and many commands do not need it. Copies of a job made by `dataclasses.replace` share the
    choice in `held_out_choice`. `allowed_stations` contains the stations at which positions may be measured or held
    out, in measuring order. `latencies_from` is the identity of the run that has shown the latencies in `settings`; it
    is empty if they are as stated in the settings file. `stated_timing` is the section `timing` of the settings file;
    it is None if `settings` has it unchanged.
    """

    settings: Settings
    machine: MachineDescription
    artefact: Artefact
    positions: tuple[Position, ...]
    held_out_choice: HeldOutChoice
    allowed_stations: tuple[int, ...]
    layout: MeasuringLayout
    rules: PositionRules
    preparation: Preparation
    gate_limits: GateSettings
    latencies_from: str = ""
    stated_timing: TimingSettings | None = None

    @property
    def latencies_text(self) -> str:
        """Origin of the latencies with which machine times are predicted, in words."""
        return f"of run {self.latencies_from}" if self.latencies_from else "of the settings"

    @property
    def held_out(self) -> tuple[Position, ...]:
        """Held-out positions. Raises ConfigurationError when first read if no position can be held out."""
        return self.held_out_choice.positions

    @property
    def verified_stations(self) -> tuple[int, ...]:
        """Stations of the held-out positions."""
        return tuple(dict.fromkeys(position.station for position in self.held_out))

    @property
    def stations(self) -> tuple[int, ...]:
        """Stations at which positions are measured or held out, in measuring order."""
        needed = {position.station for position in (*self.positions, *self.held_out)}
        return tuple(station for station in self.allowed_stations if station in needed)

    @property
    def tool_offset_mm(self) -> Array:
        return np.asarray(self.machine.tools[self.settings.tool], dtype=np.float64)

    @property
    def start_mm(self) -> Point:
        """Axis positions in mm at which a plan is assumed to start: the lower ends of travel, with the stylus withdrawn
        from the workspace.
        """
        return self.layout.frame.withdrawn_corner(self.machine.limits)

    @property
    def procedure(self) -> Procedure:
        """Measuring procedure for the design of position sets and for the error budget.

        It consists of the measuring layout and of the covariance of the measured ball centres. It contains neither
        devices nor a measuring order.
        """
        probing, qualifying = self.rules.probing, self.preparation.qualification
        if qualifying is None:
            covariance = centre_covariance(probing.directions, probing.touch_sigma_mm)
        else:
            covariance = qualifying.centre_covariance(probing)
        return Procedure({self.settings.tool: self.layout}, covariance)

    @cached_property
    def measuring_order(self) -> MeasuringOrder:
        """Order in which the position set and the held-out positions are measured before the new compensation table is
        active.
        """
        both = (*self.positions, *self.held_out)
        carried = self.rules.change.moves_artefact
        standing_at = self.settings.stations.standing_at if carried else None
        if self.rules.placement is not None or not self.settings.procedure.optimise_order:
            return MeasuringOrder("measure", by_station(both, self.stations), standing_at)
        stations = self._ordering.stations(self.stations, standing_at, self.verified_stations)
        return MeasuringOrder("measure", self._ordering.positions(both, stations), standing_at)

    @cached_property
    def _ordering(self) -> OrderOptimiser:
        times = time_model(self.machine, self.settings.timing)
        return OrderOptimiser(self.layout, self.rules, times, self._hidden_after_stations)

    def _hidden_after_stations(self, stations: frozenset[int]) -> float:
        """Return the error in µm that a change of the machine could leave unnoticed if only these stations are measured
        after it; 0 if no station is measured before it."""
        planned = self._planned
        after = [place for place, position in enumerate(planned.positions) if position.station in stations]
        if not 0 < len(after) < len(planned.positions):
            return 0.0
        hidden = self.step_visibility.largest(after)
        return math.inf if hidden is None else hidden.vce_um

    @cached_property
    def _planned(self) -> PlannedMeasurement:
        return self.procedure.plan(self.positions)

    @cached_property
    def step_visibility(self) -> StepVisibility:
        """Visibility of a sudden change of the machine between the positions of the position set, in the order of the
        planned measurement."""
        return self._visibility(self._planned.observations)

    def _visibility(self, observations: Observations) -> StepVisibility:
        artefact_k = self.settings.temperature.artefact_uncertainty_k
        options = replace(AS_STATED, temperature_standard_uncertainty_k=artefact_k)
        family = self.machine.family
        return StepVisibility.planned(family, self.artefact, observations, options, self.tool_offset_mm)

    @cached_property
    def closing_positions(self) -> tuple[Position, ...]:
        """Positions of the first station that are measured again at the end: those that together show a change of the
        machine best. They are chosen one after the other. Positions that cannot be measured are left out."""
        once = [one for one in self.measuring_order.positions if one in self._planned.positions]
        count = self.settings.procedure.closing_positions
        if count == 0 or not once:
            return ()
        again = [one for one in once if one.station == once[0].station]
        both = self._visibility(self.procedure.plan((*once, *again)).observations)
        chosen = list[int]()
        for _ in range(min(count, len(again))):
            left = [number for number in range(len(again)) if number not in chosen]
            hidden = [_hidden_um(both, len(once), sorted((*chosen, number))) for number in left]
            chosen.append(left[hidden.index(min(hidden))])
        return tuple(again[number] for number in sorted(chosen))

    @property
    def hidden_step(self) -> HiddenStep | None:
        """Largest sudden change of the machine that the measurement could hide. Positions are numbered in the order of
        measuring, from 0, closing positions last. Those that cannot be measured are left out; None if fewer than two
        remain."""
        listed = (*self.measuring_order.positions, *self.closing_positions)
        numbers = [number for number, one in enumerate(listed) if one in self._planned.positions]
        observations = self.procedure.plan([listed[number] for number in numbers]).observations
        hidden = self._visibility(observations).largest_in_order(range(len(numbers)))
        return None if hidden is None else hidden.numbered(numbers)

    @property
    def repeat_rules(self) -> RepeatRules:
        """Rules for measuring positions of the first station again at the end of the measurements: the closing
        positions or, if the temperature of the machine has changed, the first positions of the position set.

        Held-out positions are not repeated.
        """
        chosen = self.settings.temperature
        return RepeatRules(
            chosen.repeat_after_change_k,
            chosen.declared_change_k,
            chosen.repeat_positions,
            self.positions,
            self.closing_positions,
        )

    def preparation_plan(self) -> Plan[PreparationResult]:
        """Return the plan of the checks that precede all measurements: probe check, stylus qualification and reversal
        test.
        """
        return prepare_probe(self.measuring_order, self.layout, self.rules, self.preparation)

    def verification_order(self, standing_at: int | None, placed: Position | None = None) -> MeasuringOrder:
        """Return the order in which the held-out positions are measured with the new compensation table active.

        `standing_at` is the station at which the artefact stands. The order starts there if held-out positions are
        measured at this station. `placed` is the position in which an artefact that is placed by hand stands; it comes
        first if it is held out.
        """
        if self.rules.placement is not None:
            order = tuple(sorted(self.held_out, key=lambda position: position != placed))
            return MeasuringOrder("verify", order, standing_at, placed)
        stations = sorted(self.verified_stations, key=lambda s: (s != standing_at, -s))
        if not self.settings.procedure.optimise_order:
            return MeasuringOrder("verify", by_station(self.held_out, stations), standing_at)
        return MeasuringOrder("verify", self._ordering.positions(self.held_out, stations), standing_at)

    def balls_of(self, measured: MeasuredPositions, *, held_out: bool, again: bool = False) -> list[MeasuredBall]:
        """Return those balls in `measured` that belong to held-out positions or, if `held_out` is False, to all other
        positions.

        The balls are numbered as in `artefact`. If `again` is True, the repeated measurement of the first ball of each
        position is included.
        """
        kept_out = {(p.station, p.azimuth_deg, p.elevation_deg) for p in self.held_out}
        chosen = (
            ball
            for position in measured.positions
            for ball in (position.all_balls if again else position.balls)
            if ((ball.station, ball.azimuth_deg, ball.elevation_deg) in kept_out) is held_out
        )
        return numbered_together(chosen, self.layout)


def _hidden_um(both: StepVisibility, once: int, again: list[int]) -> float:
    """Return the error in µm of the largest hidden step, if the positions `again` are repeated after the first `once`
    ones."""
    chosen = both.restricted_to([*range(once), *(once + number for number in again)])
    hidden = chosen.largest_in_order(range(len(chosen.design)))
    return math.inf if hidden is None else hidden.vce_um


Planner = Callable[[Job], RunPlan]
"""Function that takes a job and returns the plan of a run."""
