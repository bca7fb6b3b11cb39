"""HTML that notebooks show for the values of the library: facts, a table, and the figure of an estimate or a table."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from functools import singledispatch
from html import escape

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.compensation.controllers.export_format import ControllerExport
from twin.compensation.table import CompensationTable
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import StoredEstimate
from twin.identification import Estimate
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_description import MachineDescription
from twin.units import UM_PER_MM
from volcal.estimation import Prediction, VolumetricErrors, volumetric_errors
from volcal.figures import error_map, table_map
from volcal.measuring_setup import MeasuringSetup
from volcal.position_design import Design
from volcal.simulation import Simulation

MOST_ROWS = 12
"""Rows of a table that are shown; the number of the others is stated."""


@singledispatch
def html_of(_: object) -> str | None:
    """Return the HTML of a value of the library, None for any other value."""
    return None


@html_of.register
def _estimate(estimate: Estimate) -> str:
    errors = volumetric_errors(estimate)
    facts = [
        ("estimate", f"{len(estimate.parameters)} parameters, Legendre order {max(estimate.model.highest_order)}"),
        ("volumetric error", f"{errors.before.aligned_um:.2f} µm"),
        ("expected after compensation", f"{errors.after.aligned_um:.2f} µm"),
        ("normalised χ²", f"{estimate.chi2_normalised:.2f}"),
        ("degrees of freedom", f"{estimate.degrees_of_freedom:.0f}"),
        ("balls rejected", f"{len(estimate.rejected)} of {len(estimate.residuals_mm)}"),
    ]
    return _facts(facts) + _image(error_map(estimate).png())


@html_of.register
def _stored_estimate(estimate: StoredEstimate) -> str:
    errors = np.sqrt(np.diagonal(estimate.covariance))
    return _facts(
        [
            ("stored estimate", f"{len(estimate.parameters)} parameters"),
            ("Legendre order", f"{max(estimate.model.highest_order)}"),
            ("largest standard uncertainty", f"{_largest_um(estimate, errors):.2f} µm"),
        ]
    )


@html_of.register
def _errors(errors: VolumetricErrors) -> str:
    rows = [
        (name, f"{value.aligned_um:.2f}", f"{value.raw_um:.2f}")
        for name, value in (("before compensation", errors.before), ("expected after it", errors.after))
    ]
    return _table(("volumetric error / µm", "aligned", "raw"), rows)


@html_of.register
def _prediction(prediction: Prediction) -> str:
    motion = "removed" if prediction.aligned else "included, with its stated uncertainty"
    errors, sigmas = UM_PER_MM * prediction.error_mm, UM_PER_MM * prediction.standard_uncertainty_mm
    rows = [
        (*(f"{value:g}" for value in point), *(f"{e:.2f} ± {u:.2f}" for e, u in zip(error, sigma, strict=True)))
        for point, error, sigma in zip(prediction.points_mm, errors, sigmas, strict=True)
    ]
    heads = (*(f"{axis} / mm" for axis in AXES), *(f"error {axis} / µm" for axis in AXES))
    return _facts([("rigid motion of the workspace", motion), ("uncertainties", "standard (k = 1)")]) + _table(
        heads, rows
    )


@html_of.register
def _balls(balls: BallFile) -> str:
    seen = balls.observations
    facts = [("ball centres", f"{seen.size} in {len(balls.positions)} positions"), *_temperature(seen.temperature_c)]
    counts = np.bincount(seen.position, minlength=len(balls.positions))
    rows = [
        (f"{number}", f"{p.station}", f"{p.azimuth_deg:g}", f"{p.elevation_deg:g}", f"{count}")
        for number, p, count in zip(
            balls.numbers or range(len(balls.positions)), balls.positions, counts.tolist(), strict=True
        )
    ]
    return _facts(facts) + _table(("position", "station", "azimuth / °", "elevation / °", "balls"), rows)


@html_of.register
def _simulation(simulation: Simulation) -> str:
    return _facts([("simulated measurement", "the true machine is known: .true_error(points_mm)")]) + _balls(
        simulation.balls
    )


@html_of.register
def _design(found: Design) -> str:
    facts = [
        ("expected volumetric error", f"{found.valuation.before.aligned_um:.2f} µm"),
        ("expected after compensation", f"{found.valuation.after.aligned_um:.2f} µm"),
        ("removed", f"{found.valuation.percent:.0f} %"),
    ]
    rows = [(f"{p.station}", f"{p.azimuth_deg:g}", f"{p.elevation_deg:g}") for p in found.positions]
    return _facts(facts) + _table(("station", "azimuth / °", "elevation / °"), rows)


@html_of.register
def _compensation_table(table: CompensationTable) -> str:
    largest = UM_PER_MM * np.abs(table.corrections).reshape(-1, 3).max(axis=0)
    facts = [
        ("machine, artefact", f"{table.machine or 'not stated'}, {table.artefact or 'not stated'}"),
        ("nodes X × Y × Z", " × ".join(str(len(nodes)) for nodes in table.nodes)),
        ("largest correction X, Y, Z", ", ".join(f"{value:.1f}" for value in largest) + " µm"),
        ("nodes outside the measured region", f"{100.0 * table.extrapolated.mean():.0f} %"),
    ]
    if table.gates_not_passed:
        facts.append(("gates not passed", ", ".join(table.gates_not_passed)))
    return _facts(facts) + _image(table_map(table).png())


@html_of.register
def _machine(machine: MachineDescription) -> str:
    facts = [("machine", machine.name), ("chain", str(machine.model.chain))]
    facts += [
        (f"tool {name}", ", ".join(f"{value:g}" for value in offset) + " mm") for name, offset in machine.tools.items()
    ]
    rows = [
        (axis, f"{low:g} to {high:g}", f"{rapid:g}", f"{feed:g}", f"{acceleration:g}")
        for axis, (low, high), rapid, feed, acceleration in zip(
            AXES, machine.limits, machine.rapid_mm_per_min, machine.feed_mm_per_min,
            machine.acceleration_mm_per_s2, strict=True,
        )
    ]  # fmt: skip
    heads = ("axis", "travel / mm", "rapid / mm/min", "feed / mm/min", "acceleration / mm/s²")
    return _facts(facts) + _table(heads, rows)


@html_of.register
def _artefact(artefact: Artefact) -> str:
    facts = [
        ("artefact", artefact.name),
        ("certificate", artefact.certificate),
        ("balls", f"{artefact.count} of {artefact.ball_diameter_mm:g} mm"),
        ("thermal expansion", f"{1e6 * artefact.cte_per_k:g} ppm/K"),
    ]
    sigmas = UM_PER_MM * np.sqrt(np.diagonal(artefact.covariance)).reshape(-1, 3)
    rows = [
        (f"{ball}", *(f"{value:.4f}" for value in centre), ", ".join(f"{value:.2f}" for value in sigma))
        for ball, (centre, sigma) in enumerate(zip(artefact.balls, sigmas, strict=True))
    ]
    return _facts(facts) + _table(("ball", "X / mm", "Y / mm", "Z / mm", "uncertainty X, Y, Z / µm (k = 1)"), rows)


@html_of.register
def _setup(setup: MeasuringSetup) -> str:
    facts = [("machine", setup.machine.name), ("artefact", setup.artefact.name), ("tool", setup.tool_name)]
    rows = [
        (f"{number}", *(f"{value:g}" for value in place)) for number, place in enumerate(setup.stations_mm, start=1)
    ]
    return _facts(facts) + _table(("station", *(f"{axis} / mm" for axis in AXES)), rows)


@html_of.register
def _export(export: ControllerExport) -> str:
    facts = [("files", ", ".join(export.files))]
    facts += [("not represented", loss) for loss in export.losses]
    facts += [(name.replace("_", " "), str(value)) for name, value in export.facts.items()]
    return _facts(facts)


def _largest_um(estimate: StoredEstimate, sigmas: Array) -> float:
    lengths = [sigma for one, sigma in zip(estimate.model.parameters, sigmas, strict=True) if one.unit == "mm"]
    return float(UM_PER_MM * max(lengths, default=0.0))


def _temperature(temperature_c: Array) -> list[tuple[str, str]]:
    if not len(temperature_c):
        return []
    return [("artefact", f"{temperature_c.min():.2f} to {temperature_c.max():.2f} °C")]


def _facts(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><th style='text-align:left'>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table>{cells}</table>"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows[:MOST_ROWS])
    left = f"<p>and {len(rows) - MOST_ROWS} more</p>" if len(rows) > MOST_ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{left}"


def _image(png: bytes) -> str:
    return f"<img style='max-width:100%' src='data:image/png;base64,{base64.b64encode(png).decode('ascii')}'>"
