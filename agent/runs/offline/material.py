"""Contents of the input files of an identification from files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.files import read_text, translated
from agent.model_files import load_artefact, load_balls, load_instruments, load_machine
from agent.runs.offline.request import IdentificationRequest
from agent.thermal.thermometer import ThermometerStatement
from drivers.errors import ConfigurationError, InputError
from twin.artefact.artefact import Artefact
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import parse_estimate
from twin.identification import Options, process_noise
from twin.identification.checks.measured_shape import check_shape
from twin.identification.identify import accepted_rows
from twin.identification.order import ORDERS
from twin.machine.error_model import ErrorModel
from twin.machine.machine_description import MachineDescription
from twin.monitoring.night_fit import NightFit, compare_with_nights_before
from twin.units import MM_PER_UM


@dataclass(frozen=True)
class IdentificationInput:
    """Contents of the input files of an identification: machine, artefact, measured balls and options. `tool` is the
    tool for which the compensation table is made, and `thermometer` the uncertainty of the artefact's temperature.
    `night` compares the balls with the carried-over estimate; it is None without one."""

    machine: MachineDescription
    artefact: Artefact
    balls: BallFile
    tool: str
    options: Options
    thermometer: ThermometerStatement
    night: NightFit | None = None


def read_material(request: IdentificationRequest) -> IdentificationInput:
    """Return the contents of the input files of an identification.

    Raises UserError if a part of a file cannot be used. The message names the file and the key or the row.
    """
    machine = load_machine(request.machine)
    artefact = load_artefact(request.artefact)
    balls = load_balls(request.balls, machine)
    if not machine.family.half_widths.any():
        hint = "enter the half-widths of machines of this kind"
        message = "every half-width of the family is zero, so there is nothing to identify"
        raise ConfigurationError(message, hint=hint, file=str(request.machine), key="model.family")
    tool = _table_tool(request, machine, balls)
    thermometer = _thermometer(request, balls)
    options = replace(request.options, temperature_standard_uncertainty_k=thermometer.standard_uncertainty_k)
    material = IdentificationInput(machine, artefact, balls, tool, options, thermometer)
    if request.carried_over is not None:
        material = _after_earlier_night(material, request, request.carried_over)
    return _with_instruments(material, request) if request.instruments else material


def _with_instruments(material: IdentificationInput, request: IdentificationRequest) -> IdentificationInput:
    """Return `material` with the readings of other instruments among its options. Values of an earlier report must be
    those of parameters that every order which may be chosen has."""
    machine, options = material.machine, material.options
    if options.carried_over is not None:
        model = options.carried_over.unknowns.model
    elif request.order == "file":
        model = machine.model
    else:
        model = machine.with_order(ORDERS[0] if request.order == "evidence" else request.order).model
    readings = load_instruments(request.instruments, machine, model)
    with translated(ConfigurationError):
        joined = replace(options, instruments=readings, join_contradicting=request.join_contradicting)
    return replace(material, options=joined)


def _thermometer(request: IdentificationRequest, balls: BallFile) -> ThermometerStatement:
    """Return the uncertainty of the artefact's temperature. The settings describe a thermometer, so they do not apply
    to a file without temperatures."""
    stated_k = request.temperature_uncertainty_k
    if stated_k is None and balls.temperature_was_read:
        stated_k = request.thermometer_uncertainty_k
    return ThermometerStatement.of(stated_k, balls.temperature_was_read)


def _after_earlier_night(
    material: IdentificationInput, request: IdentificationRequest, path: Path
) -> IdentificationInput:
    """Return `material` with the earlier estimate in `path` as prior, widened by the change since that estimate, and
    with the comparison of the balls with that estimate.

    Balls that contradict the others of the same night are left out of the comparison.
    """
    machine, artefact, options, balls = material.machine, material.artefact, material.options, material.balls
    seen = balls.observations
    text = read_text(path)
    with translated(InputError, file=str(path)):
        known = parse_estimate(text, str(path)).carried_over()
        _check_same_beams(machine.model, known.unknowns.model, str(request.machine))
        family = machine.with_model(known.unknowns.model).family
        noise = process_noise(family, MM_PER_UM * request.process_noise_um, machine.tool(material.tool))
    known = known if balls.temperature_was_read else known.for_another_thermometer()
    with translated(ConfigurationError):
        replace(options, carried_over=known)  # refuses options that do not go with an earlier estimate
    with translated(file=str(request.balls)), balls.places_named():
        check_shape(seen, artefact)
        night = compare_with_nights_before(
            family,
            seen.select(accepted_rows(family, seen, artefact, options).mask),
            artefact,
            known,
            noise,
            options=options,
            night_false_alarm=request.gates.night_false_alarm,
        )
    return replace(material, options=replace(options, carried_over=night.prior), night=night)


def _check_same_beams(nominal: ErrorModel, earlier: ErrorModel, machine: str) -> None:
    """Raise DataError if the cross-effect or the beams of the machine file are not those of the earlier estimate, whose
    model would replace them."""
    if (nominal.cross_effect, nominal.structure) != (earlier.cross_effect, earlier.structure):
        raise DataError(
            f"the cross-effect or the beams of the machine in {machine} have been changed since this estimate",
            hint="identify without --carried-over once, or use the machine file of that estimate",
        )


def _table_tool(request: IdentificationRequest, machine: MachineDescription, balls: BallFile) -> str:
    names = list(machine.tools)
    if request.tool is None:
        return names[int(np.bincount(balls.observations.tool).argmax())]
    if request.tool not in names:
        hint = f"Known tools: {', '.join(names)}"
        raise ConfigurationError(f"the machine has no tool '{request.tool}'", hint=hint, file=str(request.machine))
    return request.tool
