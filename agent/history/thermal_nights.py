"""Nights of a machine as the explanation of its drift needs them: estimates with their covariances, and readings of its
temperature sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.files import present_file, read_text, translated
from agent.history.schema import StoredRun, StoredTemperature, utc_time
from agent.history.series import CHANGED_MACHINE, nights_of
from agent.model_files import load_machine
from agent.planning.expected_walk import expected_walk
from agent.settings.schema import Settings
from agent.settings.temperature import why_no_drift_sensor
from agent.workpiece.estimate_and_table import ESTIMATE_NAME
from drivers.errors import InputError
from twin.arrays import Array
from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.machine.machine_description import MachineDescription
from twin.monitoring.drift_evidence import MOST_SENSORS
from twin.monitoring.thermal_drift import FusedWith, NightEstimate
from twin.units import MICRO_UNITS

_LEAST_RECORDED = 0.5  # of the runs: a sensor that is chosen without being named


@dataclass(frozen=True, eq=False)
class ThermalNights:
    """Nights of a machine with n estimates of the same p parameters, the oldest first.

    `run_ids` and `started_s` (n,), in seconds since 1970, belong to `nights`. `reference` is the latest estimate that
    has a file, of the run `reference_run`, and `reference_place` its index among the nights. `expected` (p, p) is the
    covariance of the parameters of the machine's family, in mm and rad. `steps` are the days at which the machine was
    found changed. `without_file` is the number of separable nights of which only the standard uncertainties are known.
    """

    machine: MachineDescription
    tool_offset_mm: Array
    sensors: tuple[str, ...]
    run_ids: tuple[str, ...]
    started_s: Array
    nights: tuple[NightEstimate, ...]
    reference: StoredEstimate
    reference_run: str
    reference_file: Path
    reference_place: int
    expected: Array
    steps: tuple[float, ...]
    without_file: int

    @property
    def inseparable(self) -> int:
        """Number of nights that were fused with an estimate whose file, or whose own file, is gone."""
        return sum(not one.separable for one in self.nights)


def recorded_sensors(runs: Sequence[StoredRun], settings: Settings, named: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names of the sensors that may explain the drift: `named` by the option `--sensor`, or those of the
    settings, or all that most runs recorded except those of the artefact.

    Raises InputError if there is none, if there are too many, if one is named twice or is one of the artefact, or if no
    run has recorded one of them. It names the option or the settings key that stated the sensors.
    """
    place = {"option": "--sensor"} if named else {"key": "temperature.drift_sensors"}
    stated = tuple(named or settings.temperature.drift_sensors)
    counts: dict[str, int] = {}
    with_estimate = [run for run in runs if run.parameters]
    for run in with_estimate:
        for one in run.temperatures:
            counts[one.sensor] = counts.get(one.sensor, 0) + 1
    known = ", ".join(sorted(counts)) or "none"
    of_artefact = settings.temperature.artefact_sensors
    if not stated:
        often = _LEAST_RECORDED * len(with_estimate)
        stated = tuple(name for name in sorted(counts) if name not in of_artefact and counts[name] >= often)
    if not stated:
        raise InputError(
            "no run has recorded a temperature sensor of the machine",
            hint="name the sensors in the settings of the driver; recorded: " + known,
            **place,
        )
    for name in stated:
        if reason := why_no_drift_sensor(name, stated, of_artefact):
            raise InputError(reason, hint=f"recorded sensors: {known}", **place)
        if name not in counts:
            raise InputError(
                f"no run with an estimate has recorded the sensor {name!r}",
                hint=f"recorded sensors: {known}",
                **place,
            )
    if len(stated) > MOST_SENSORS:
        raise InputError(
            f"{len(stated)} sensors ({', '.join(stated)}) are too many, at most {MOST_SENSORS} explain a drift",
            hint=f"choose {MOST_SENSORS}",
            **place,
        )
    return stated


def thermal_nights(runs: Sequence[StoredRun], settings: Settings, sensors: Sequence[str]) -> ThermalNights:
    """Return the nights of this machine from its `runs`, the oldest first, and from the estimates in the folders of the
    state directory. Raises InputError if no run has an estimate with a file."""
    ended = [run for run in runs if run.parameters and run.ended is not None]
    files = {run.run_id: settings.state_directory / run.run_id / ESTIMATE_NAME for run in ended}
    estimates = {run_id: _read(path) for run_id, path in files.items() if present_file(path).exists()}
    if not estimates:
        raise InputError(
            "no run with an estimate is in the state directory",
            hint="calibrate first; `volcal history list` shows all runs",
            folder=str(settings.state_directory),
        )
    reference_run = next(run.run_id for run in reversed(ended) if run.run_id in estimates)
    reference = estimates[reference_run]
    machine = load_machine(settings.machine)
    with translated(file=str(settings.machine)):
        machine = machine.with_model(reference.model)
    offset = machine.tool(settings.tool)
    walk = expected_walk(machine, offset, settings.nightly)
    names = reference.model.names
    alike = [run for run in ended if tuple(one.name for one in run.parameters) == names]
    days = dict(zip((run.run_id for run in runs), nights_of(runs).tolist(), strict=True))
    nights = tuple(
        _night(run, days[run.run_id], estimates, sensors, walk, settings.temperature.drift_sensor_uncertainty_k)
        for run in alike
    )
    return ThermalNights(
        machine,
        offset,
        tuple(sensors),
        tuple(run.run_id for run in alike),
        np.array([utc_time(run.started).timestamp() for run in alike]),
        nights,
        reference,
        reference_run,
        files[reference_run],
        [run.run_id for run in alike].index(reference_run),
        np.diag(machine.family.prior_standard_deviation**2),
        tuple(days[run.run_id] for run in runs if run.night in CHANGED_MACHINE),
        sum(run.run_id not in estimates and one.separable for run, one in zip(alike, nights, strict=True)),
    )


def _read(path: Path) -> StoredEstimate:
    with translated(file=str(path)):
        return parse_estimate(read_text(path), str(path))


def _night(
    run: StoredRun,
    day: float,
    estimates: dict[str, StoredEstimate],
    sensors: Sequence[str],
    walk: Array,
    sensor_sigma_k: float,
) -> NightEstimate:
    readings = {one.sensor: one for one in run.temperatures}
    found = [readings.get(name) for name in sensors]
    means = np.array([math.nan if one is None else one.mean for one in found])
    sigmas = np.array([math.nan if one is None else reading_uncertainty_k(one, sensor_sigma_k) for one in found])
    estimate = estimates.get(run.run_id)
    was_fused = run.since is not None and run.night not in CHANGED_MACHINE
    if estimate is None:
        factors = np.array([1.0 / dict(MICRO_UNITS.values())[one.unit] for one in run.parameters])
        values, deviations = factors * run.parameter_arrays.values, factors * run.parameter_arrays.sigmas
        # The correlations are gone, without which the prior cannot be taken out of a fused estimate.
        return NightEstimate(day, values, np.diag(deviations**2), means, sigmas, separable=not was_fused)
    # A full calibration whose table was taken back has the decision of a fused night, but was made from itself alone.
    was_fused = was_fused and estimate.was_fused
    before = estimates.get(str(run.since)) if was_fused else None
    fused = None if before is None else _fused_with(before, estimate, walk, run.nights or 1.0)
    separable = fused is not None or not was_fused
    return NightEstimate(day, estimate.parameters, estimate.covariance, means, sigmas, fused, separable)


def _fused_with(before: StoredEstimate, estimate: StoredEstimate, walk: Array, nights: float) -> FusedWith | None:
    """Return the prior with which a night was fused: the estimate before it, aged by the walk as that night learned it.
    None if the models differ, which fusing excludes."""
    if before.model.names != estimate.model.names:
        return None
    aged = replace(before.carried_over(), drift_factor=estimate.drift_factor).after(walk, nights)
    own, unknowns = aged.unknowns.blocks.parameters, aged.unknowns
    return FusedWith(unknowns.parameters(aged.mean), unknowns.physical_covariance(aged.covariance[own, own]))


def reading_uncertainty_k(reading: StoredTemperature, sensor_sigma_k: float) -> float:
    """Return the standard uncertainty in K of the mean temperature of a run: that of the sensor, and that of a
    rectangular distribution over the range of its readings (GUM 4.3.7)."""
    return math.hypot(sensor_sigma_k, (reading.highest - reading.lowest) / math.sqrt(12.0))
