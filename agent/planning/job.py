"""Job of a run: the calibration prepared from the settings and from the files that the settings name. No device is
contacted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from agent.execution.steps import Plan
from agent.files import translated
from agent.model_files import load_machine, load_positions
from agent.planning.measuring_order import OrderOptimiser
from agent.planning.procedure_rules import layout_of, preparation_of, probing_of, retreat_of
from agent.planning.stations import check_stations, load_artefacts, station_change
from agent.planning.temperature_rules import drift_limits_of, settling_of
from agent.planning.time_model import time_model
from agent.probing.position import MeasuredBall, PositionRules
from agent.probing.preparation import Preparation, PreparationResult, prepare_probe
from agent.probing.repeated_positions import RepeatRules
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, by_station
from agent.settings.load import POSITION_FILES
from agent.settings.schema import GateSettings, Settings
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import Position, parse_position_set
from twin.artefact.touch_pattern import centre_covariance
from twin.collision.measuring_layout import MeasuringLayout
from twin.design.procedure import MIN_BALLS, Procedure
from twin.machine.machine_description import MachineDescription


@dataclass(frozen=True)
class Job:
    """Prepared calibration, which can be listed, checked by a preflight and carried out.

    `positions` are measured to estimate the errors of the machine. The positions `held_out` are never used for this
    estimate; they verify it.
    """

    settings: Settings
    machine: MachineDescription
    artefact: Artefact
    positions: tuple[Position, ...]
    held_out: tuple[Position, ...]
    stations: tuple[int, ...]
    verified_stations: tuple[int, ...]
    layout: MeasuringLayout
    rules: PositionRules
    preparation: Preparation
    gate_limits: GateSettings

    @property
    def tool_offset_mm(self) -> Array:
        return np.asarray(self.machine.tools[self.settings.tool], dtype=np.float64)

    @property
    def procedure(self) -> Procedure:
        """Measuring procedure for the design of position sets and for the error budget.

        It consists of the measuring layout (places of the artefact, reach of the axes) and of the covariance of the
        measured ball centres. It contains neither devices nor a measuring order.
        """
        probing = self.rules.probing
        covariance = centre_covariance(probing.directions, probing.touch_sigma_mm)
        return Procedure({self.settings.tool: self.layout}, covariance)

    @cached_property
    def measuring_order(self) -> MeasuringOrder:
        """Order in which the position set and the held-out positions (used only for verification) are measured before
        the new compensation table is active.
        """
        both = (*self.positions, *self.held_out)
        carried = self.rules.change.moves_artefact
        standing_at = self.settings.stations.standing_at if carried else None
        if not self.settings.procedure.optimise_order:
            return MeasuringOrder("measure", by_station(both, self.stations), standing_at)
        stations = self._ordering.stations(self.stations, standing_at, self.verified_stations)
        return MeasuringOrder("measure", self._ordering.positions(both, stations), standing_at)

    @cached_property
    def _ordering(self) -> OrderOptimiser:
        return OrderOptimiser(self.layout, self.rules, time_model(self.machine, self.settings.timing))

    @property
    def repeat_rules(self) -> RepeatRules:
        """Rules for measuring the first positions of the position set again at the end of the measurements if the
        temperature of the machine has changed.

        Held-out positions are not repeated.
        """
        chosen = self.settings.temperature
        return RepeatRules(
            chosen.repeat_after_change_k, chosen.declared_change_k, chosen.repeat_positions, self.positions
        )

    def preparation_plan(self) -> Plan[PreparationResult]:
        """Return the plan of the checks that precede all measurements: probe check, stylus qualification and reversal
        test.
        """
        return prepare_probe(self.measuring_order, self.layout, self.rules, self.preparation)

    def verification_order(self, standing_at: int | None) -> MeasuringOrder:
        """Return the order in which the held-out positions are measured with the new compensation table active.

        `standing_at` is the station at which the artefact stands. The order starts there if held-out positions are
        measured at this station.
        """
        order = sorted(self.verified_stations, key=lambda s: (s != standing_at, -s))
        if not self.settings.procedure.optimise_order:
            return MeasuringOrder("verify", by_station(self.held_out, order), standing_at)
        return MeasuringOrder("verify", self._ordering.positions(self.held_out, order), standing_at)

    def balls_of(self, measured: MeasuredPositions, *, held_out: bool, again: bool = False) -> list[MeasuredBall]:
        """Return those balls in `measured` that belong to held-out positions or, if `held_out` is False, to all other
        positions.

        The balls are numbered as in `artefact`. If `again` is True, the repeated measurement of the first ball of each
        position is included.
        """
        kept_out = {(p.station, p.azimuth_deg, p.elevation_deg) for p in self.held_out}
        return [
            replace(ball, ball=ball.ball + self.layout.first_ball(ball.station))
            for position in measured.positions
            for ball in (position.all_balls if again else position.balls)
            if ((ball.station, ball.azimuth_deg, ball.elevation_deg) in kept_out) is held_out
        ]


def prepare_job(settings: Settings, base: Path) -> Job:
    """Load the files that the settings name, check that they are consistent, and return the job.

    `base` is the folder to which the path of a position file is relative. Raises ConfigurationError if a file cannot be
    used or if the files and settings are not consistent.
    """
    check_stations(settings)
    machine = load_machine(settings.machine)
    artefacts = load_artefacts(settings.artefact, settings.stations)
    if settings.tool not in machine.tools:
        raise ConfigurationError(
            f"the machine has no tool {settings.tool!r}",
            key="tool",
            hint=f"tools of {settings.machine.name}: {', '.join(sorted(machine.tools))}",
        )
    stations = tuple(settings.procedure.stations or range(1, len(settings.stations.places_mm) + 1))
    positions = _positions(
        settings.procedure.position_set, stations, len(settings.stations.places_mm), base, settings.tool
    )
    verified = tuple(settings.verification.stations or stations)
    held_out = tuple(
        Position(station, azimuth, elevation)
        for station in verified
        for azimuth, elevation in settings.verification.positions_deg
    )
    _refuse_overlap(positions, held_out)
    used = tuple(dict.fromkeys((*stations, *(p.station for p in positions), *verified)))
    probing = probing_of(settings.procedure, settings.probe.tip_radius_mm, artefacts.kind)
    job = Job(
        settings=settings,
        machine=machine,
        artefact=artefacts.all,
        positions=positions,
        held_out=held_out,
        stations=used,
        verified_stations=verified,
        layout=layout_of(settings, machine, artefacts, probing),
        preparation=preparation_of(settings, machine, artefacts, probing),
        rules=PositionRules(
            probing,
            retreat_of(settings.stations, settings.procedure, settings.timing, machine),
            drift_limits_of(settings.procedure, settings.temperature),
            settling_of(settings.temperature),
            station_change(settings.roles, settings.stations),
        ),
        gate_limits=settings.gates,
    )
    _refuse_nothing_reachable(job)
    if settings.procedure.position_set.endswith(POSITION_FILES):
        _refuse_unreachable_entry(job)
    return job


def _positions(name: str, stations: Sequence[int], station_count: int, base: Path, tool: str) -> tuple[Position, ...]:
    """Return the positions of the named sets at `stations`, or all positions of a position file."""
    if name.endswith(POSITION_FILES):
        listed = load_positions(base / name)
        unknown = sorted({p.station for p in listed} - set(range(1, station_count + 1)))
        if unknown:
            raise ConfigurationError(
                f"the position file names station {unknown[0]}, which has no place",
                file=name,
                key="stations.places_mm",
            )
        return tuple(_with_tool_of_run(p, number, name, tool) for number, p in enumerate(listed, start=1))
    with translated(ConfigurationError, key="procedure.position_set"):
        everywhere = parse_position_set(name, station_count)
    return tuple(p for p in everywhere if p.station in stations)


def _with_tool_of_run(position: Position, number: int, file: str, tool: str) -> Position:
    if position.tool not in (None, tool):
        raise ConfigurationError(
            f"position {number} is to be measured with tool '{position.tool}', the run has '{tool}'",
            file=file,
            key="tool",
            hint="a run has one tool: make one file for each, and fuse the runs' estimates",
        )
    return replace(position, tool=None)


def _refuse_overlap(positions: Sequence[Position], held_out: Sequence[Position]) -> None:
    common = set(positions) & set(held_out)
    if common:
        first = min(common, key=lambda p: p.station)
        raise ConfigurationError(
            f"position az {first.azimuth_deg:g}° el {first.elevation_deg:g}° is measured for the estimate, "
            "so it cannot prove it",
            key="verification.positions_deg",
            hint="choose orientations that the position set does not contain",
        )


def _refuse_nothing_reachable(job: Job) -> None:
    if all(_reached(job, position) < MIN_BALLS for position in job.positions):
        raise ConfigurationError(
            "no position has three balls within the travel",
            key="stations.places_mm",
            hint="check the stations' places, the mount's shaft and the tool offset",
        )


def _refuse_unreachable_entry(job: Job) -> None:
    """Raise ConfigurationError if an entry of a position file is out of reach.

    Unreachable positions of a named set are left out and counted, but every entry of a position file must be
    measurable.
    """
    for number, position in enumerate(job.positions, start=1):
        reached = _reached(job, position)
        if reached < MIN_BALLS:
            raise ConfigurationError(
                f"position {number} (station {position.station}, azimuth {position.azimuth_deg:g}°, elevation "
                f"{position.elevation_deg:g}°) has {reached} balls within reach, three are needed",
                file=job.settings.procedure.position_set,
                hint="leave it out, or choose another orientation or station",
            )


def _reached(job: Job, position: Position) -> int:
    return int(job.layout.reachable(position, job.layout.nominal(position)).sum())
