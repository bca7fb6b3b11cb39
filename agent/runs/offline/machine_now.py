"""Combined estimate of the machine now: its last estimate, the change of its temperatures since then, and one or two
positions measured in the last hour."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agent.files import check_folder, read_text, translated, write_all_atomically
from agent.history.sensor_drift import SensorDrift
from agent.results.artefact_calibration import CALIBRATION_FILES
from agent.runs.offline.identification import identify_files
from agent.runs.offline.request import IdentificationRequest
from agent.runs.offline.result import IdentificationResult
from agent.runs.offline.result_texts import TABLE_FILES
from agent.runs.result_files import REPORT, replaced_results
from agent.settings.schema import Settings
from agent.workpiece.estimate_and_table import ESTIMATE_NAME
from drivers.errors import InputError
from twin.arrays import Array
from twin.formats.estimate_file import parse_estimate
from twin.formats.moved_estimate import moved_estimate
from twin.identification import CarriedOverPrior, Options
from twin.machine.volumetric import evaluation_grid
from twin.monitoring.residual_with_active_table import ResidualWithTable
from twin.monitoring.thermal_drift import after_change
from twin.units import S_PER_DAY

PREDICTED_NAME = "predicted.json"
LONGEST_DAYS = 7.0
"""Age in days of the last estimate beyond which nothing is predicted from it: measure a night first."""


@dataclass(frozen=True)
class NowRequest:
    """Combined estimate that is asked for: the temperatures in °C by sensor `at` a UTC time, the folder `out` of its
    files, and the file of positions measured about then, None without one. `read_from` is the device from which the
    temperatures were read, also of sensors that are not used; None if they were stated."""

    temperatures_c: Mapping[str, float]
    at: datetime
    out: Path
    balls: Path | None = None
    read_from: str | None = None


@dataclass(frozen=True)
class ExpectedErrors:
    """Expected volumetric errors in µm, rigidly aligned: `ve_um` without a table, and `vce_um` with the table that was
    made from the last estimate."""

    ve_um: float
    vce_um: float


@dataclass(frozen=True)
class ExtrapolatedSensor:
    """Sensor whose temperature `value_c` lies outside the temperatures `lowest_c` to `highest_c` at which its effect
    was learned, in °C. `of_run` is True for the temperature in the run of the last estimate, False for that now."""

    name: str
    value_c: float
    lowest_c: float
    highest_c: float
    of_run: bool

    @property
    def text(self) -> str:
        """Sentence without a full stop."""
        when = "in the run of the last estimate" if self.of_run else "now"
        return (
            f"the sensor {self.name} shows {self.value_c:.2f} °C {when}, but its effect was learned at "
            f"{self.lowest_c:.2f} to {self.highest_c:.2f} °C: the result is extrapolated, and its uncertainty does not "
            "cover an effect that is not linear"
        )


@dataclass(frozen=True, eq=False)
class MachineNow:
    """Combined estimate of the machine.

    `then` holds for the last estimate, of the run `run_id`, `age_days` ago; `predicted` for its prediction by the
    temperatures; and `measured` for the estimate with the positions of `identification`, which is None without any.
    `moved_um` is the rms change of the error field that the temperatures explain, and `doubt_um` the rms uncertainty
    that change and time have added. `largest` are the parameters that are predicted to change most: name, change and
    standard uncertainty of the change in `unit`. `extrapolated` are the sensors whose temperatures lie outside those at
    which their effects were learned. `temperatures_c` are those now that were used, and `read_from` the device that
    gave them; None if they were stated.
    """

    machine: str
    run_id: str
    age_days: float
    sensors: tuple[str, ...]
    temperature_changes_k: Mapping[str, float]
    then: ExpectedErrors
    predicted: ExpectedErrors
    measured: ExpectedErrors | None
    moved_um: float
    doubt_um: float
    largest: tuple[tuple[str, float, float, str], ...]
    file: Path
    identification: IdentificationResult | None
    extrapolated: tuple[ExtrapolatedSensor, ...]
    temperatures_c: Mapping[str, float]
    read_from: str | None

    def as_json(self) -> dict[str, Any]:
        """Return the result as a mapping to be written as JSON (docs/reference/json.md)."""
        fits = None if self.identification is None else self.identification.material.night
        return {
            "machine": self.machine,
            "run": self.run_id,
            "age_days": self.age_days,
            "sensors": list(self.sensors),
            "temperature_changes_k": dict(self.temperature_changes_k),
            "temperatures_c": dict(self.temperatures_c),
            "temperatures_from": self.read_from,
            "then": vars(self.then),
            "predicted": vars(self.predicted),
            "measured": None if self.measured is None else vars(self.measured),
            "positions_fit": None if fits is None else fits.fits,
            "moved_um": self.moved_um,
            "doubt_um": self.doubt_um,
            "errors": [
                {"name": name, "change": change, "standard_uncertainty": sigma, "unit": unit}
                for name, change, sigma, unit in self.largest
            ],
            "extrapolated": [vars(one) for one in self.extrapolated],
            "estimate": str(self.file),
        }


def machine_now(drift: SensorDrift, settings: Settings, request: NowRequest) -> MachineNow:
    """Combine the last estimate with the temperatures and positions of `request`, and write the result into its folder:
    predicted.json, and with positions estimate.json.

    Raises InputError if a temperature of a sensor that explains the drift is missing now or in the run of the last
    estimate, if that estimate is too old, if the folder is that of a run, or if the positions cannot be used; nothing
    is written then.
    """
    check_folder(request.out)
    history, found = drift.history, drift.found
    if request.out.resolve().parent == settings.state_directory.resolve():
        raise InputError(
            "results would replace the estimate of a run", hint="choose another directory", directory=str(request.out)
        )
    last = history.nights[history.reference_place]
    days = request.at.timestamp() / S_PER_DAY - float(history.started_s[history.reference_place]) / S_PER_DAY
    if not 0.0 <= days <= LONGEST_DAYS:
        raise InputError(
            f"the last estimate is of {days:.1f} days before {request.at:%Y-%m-%d %H:%M}, "
            f"allowed 0 to {LONGEST_DAYS:g}",
            hint="state the time with --at, or measure a night",
            run=history.reference_run,
        )
    unknown = sorted(set(request.temperatures_c) - set(history.sensors))
    if unknown and request.read_from is None:
        raise InputError(
            f"unknown sensor {unknown[0]!r}", hint=f"sensors: {', '.join(history.sensors)}", option="--temperature"
        )
    to_c = np.array([request.temperatures_c.get(name, np.nan) for name in found.sensors])
    places = [history.sensors.index(name) for name in found.sensors]
    from_c = found.screened.readings_c[history.reference_place, places]
    for name, reading_c in zip(found.sensors, from_c.tolist(), strict=True):
        if name in found.taken and not math.isfinite(reading_c):
            raise InputError(
                f"the run of the last estimate has no usable reading of the sensor {name}, which explains the drift",
                hint="measure a night with this sensor, or choose other sensors with --sensor",
                run=history.reference_run,
            )
    sigmas = np.hypot(last.uncertainties_k[places], settings.temperature.drift_sensor_uncertainty_k)
    # Of a thermometer, the device is the place of a missing reading.
    place = {"option": "--temperature"} if request.read_from is None else {"device": request.read_from}
    with translated(InputError, **place):
        change, covariance = found.change(from_c, to_c, days, sigmas)
    known = history.reference.carried_over()
    moved = after_change(known, change, covariance)
    extrapolated = (*_extrapolated(drift, from_c, of_run=True), *_extrapolated(drift, to_c, of_run=False))
    identification = _written(drift, settings, request, moved, extrapolated)
    after = None
    if identification is not None:
        after = _errors(drift, identification.estimation.estimate.carried_over())
    return MachineNow(
        history.machine.name,
        history.reference_run,
        days,
        found.taken,
        {name: float(to_c[at] - from_c[at]) for at, name in enumerate(found.sensors) if np.isfinite(to_c[at])},
        _errors(drift, known),
        _errors(drift, moved),
        after,
        drift.change_um(change),
        drift.uncertainty_um(covariance),
        _largest(drift, change, covariance),
        request.out / (PREDICTED_NAME if identification is None else ESTIMATE_NAME),
        identification,
        extrapolated,
        {name: float(to_c[at]) for at, name in enumerate(found.sensors) if np.isfinite(to_c[at])},
        request.read_from,
    )


def _extrapolated(drift: SensorDrift, temperatures_c: Array, *, of_run: bool) -> tuple[ExtrapolatedSensor, ...]:
    found, (lowest, highest) = drift.found, drift.found.learned_c
    return tuple(
        ExtrapolatedSensor(
            found.sensors[at], float(temperatures_c[at]), float(lowest[at]), float(highest[at]), of_run=of_run
        )
        for at in found.extrapolated(temperatures_c)
    )


def _written(
    drift: SensorDrift,
    settings: Settings,
    request: NowRequest,
    moved: CarriedOverPrior,
    extrapolated: Sequence[ExtrapolatedSensor],
) -> IdentificationResult | None:
    """Write the predicted estimate, and identify the positions with it as prior. Nothing is written if these are wrong.
    Results of an earlier identification in the folder do not belong to the new prediction and are deleted."""
    history = drift.history
    provenance = {
        "predicted_for": request.at.isoformat(timespec="seconds"),
        "predicted_from": history.reference_run,
        "predicted_by": f"volcal {version('volcal')}",
        **_extrapolation_entry(extrapolated),
    }
    text = moved_estimate(read_text(history.reference_file), moved, provenance)
    with translated(file=PREDICTED_NAME):
        parse_estimate(text, PREDICTED_NAME)
    if request.balls is None:
        former = replaced_results(request.out, (ESTIMATE_NAME, *TABLE_FILES, REPORT, *CALIBRATION_FILES), ())
        write_all_atomically(request.out, {PREDICTED_NAME: text}, former)
        return None
    with TemporaryDirectory() as folder:
        prior = Path(folder) / PREDICTED_NAME
        write_all_atomically(prior.parent, {prior.name: text})
        result = _identified(settings, request, request.balls, prior, _extrapolation_entry(extrapolated))
    write_all_atomically(request.out, {PREDICTED_NAME: text})
    return result


def _extrapolation_entry(extrapolated: Sequence[ExtrapolatedSensor]) -> dict[str, str]:
    """Return the entry of the provenance of an estimate that says that it is extrapolated; none if it is not."""
    return {"extrapolated": "; ".join(one.text for one in extrapolated)} if extrapolated else {}


def _identified(
    settings: Settings, request: NowRequest, balls: Path, prior: Path, provenance: Mapping[str, str]
) -> IdentificationResult:
    """Identify the positions with the estimate in the file `prior` as prior."""
    chosen = settings.identification
    return identify_files(
        IdentificationRequest(
            balls=balls,
            machine=settings.machine,
            artefact=settings.artefact,
            out=request.out,
            options=Options(formulation=chosen.formulation, use_prior=True, weights="full"),
            tool=settings.tool,
            carried_over=prior,
            gates=settings.gates,
            min_gain=settings.verification.min_gain,
            table=settings.table,
            thermometer_uncertainty_k=settings.temperature.standard_uncertainty_k,
            with_report=False,
            provenance=provenance,
        ),
        request.at.isoformat(timespec="seconds"),
    )


def _errors(drift: SensorDrift, known: CarriedOverPrior) -> ExpectedErrors:
    """Return the expected volumetric errors without a table, and with that of the last estimate."""
    written = drift.history.reference.parameters
    grid = evaluation_grid(known.unknowns.model.ranges_mm)
    residual = ResidualWithTable.build(known.unknowns, known.scales, grid, drift.history.tool_offset_mm)
    bare, left = (residual.of(known.mean, known.covariance, one) for one in (np.zeros_like(written), written))
    return ExpectedErrors(bare.aligned_um, left.aligned_um)


def _largest(drift: SensorDrift, change: Array, covariance: Array) -> tuple[tuple[str, float, float, str], ...]:
    weights = np.sqrt(np.diag(drift.form)) * np.hypot(change, np.sqrt(np.diag(covariance)))
    names: Sequence[str] = drift.history.reference.model.names
    found = []
    for place in np.argsort(weights)[::-1][:6].tolist():
        unit, factor = drift.unit(place)
        sigma = float(np.sqrt(max(covariance[place, place], 0.0)))
        found.append((names[place], factor * float(change[place]), factor * sigma, unit))
    return tuple(found)
