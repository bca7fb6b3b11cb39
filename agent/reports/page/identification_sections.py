"""Sections of the report about the identification of the machine's errors: summary, residuals, fit, null directions,
compensation table and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.figures import ball_residuals
from agent.reports.page.number_format import COVERAGE, Rows, Table, fixed, micrometres, number, plural, point
from agent.reports.page.texts import Texts
from agent.results.facts import Quantity
from twin.artefact.artefact_calibration import ArtefactCalibration
from twin.identification.instruments.check_result import InstrumentCheck
from twin.units import MICRO_UNITS, UM_PER_MM

PARAMETER_COLUMNS = 4
"""With three, the table of a model of order 10 and its heading do not fit on one page."""


def summary_table(data: ReportData, identification: IdentificationData, t: Texts) -> Table:
    summary, proof = identification.volumetric, data.run.verification
    rows: list[tuple[str, Quantity | None, Quantity | None]] = [
        (t["ve_aligned"], summary.before_aligned, summary.after_aligned),
    ]
    if proof is not None:
        rows.append((t["held_out"], proof.before, proof.after))
    cells = tuple((name, micrometres(before), micrometres(after)) for name, before, after in rows)
    return Table((t["quantity"], t["before"], t["after"]), cells, (t["before"], t["after"]))


def travel_table(identification: IdentificationData, t: Texts) -> Table | None:
    """Return the volumetric error before and after compensation inside and outside the measured region, or None if the
    run does not contain it."""
    travel = identification.travel
    if travel is None:
        return None
    rows = tuple(
        (
            t[name].format(share=f"{100.0 * part.share:.0f}"),
            _with_limits(part.estimated_ve_um, part.estimated_ve_limits_um),
            _with_limits(part.predicted_vce_um, part.predicted_vce_limits_um),
        )
        for name, part in (("travel_measured", travel.measured), ("travel_unmeasured", travel.unmeasured))
        if part is not None
    )
    return Table((t["travel"], t["before"], t["after"]), rows, (t["before"], t["after"]))


def _with_limits(value_um: float, limits_um: tuple[float, float]) -> str:
    lower, upper = (number(limit, 3) for limit in limits_um)
    return f"{number(value_um, 3)} µm ({lower} to {upper})"


def residual_note(identification: IdentificationData) -> str:
    accepted = ball_residuals(identification).accepted
    rms = 1e3 * np.sqrt(np.mean(identification.residuals_mm[accepted] ** 2, axis=0))
    text = f"rms by component: x {rms[0]:.2f}, y {rms[1]:.2f}, z {rms[2]:.2f} µm over the accepted balls."
    several_stations = len({position.station for position in identification.positions}) > 1
    return f"{text} Dotted lines separate the stations." if several_stations else text


def rejected(identification: IdentificationData) -> Table | None:
    if not identification.estimate.rejected:
        return None
    rows = []
    for position, ball, tool in identification.estimate.rejected:
        place = identification.positions[position]
        where = f"station {place.station}, azimuth {place.azimuth_deg:g}°, elevation {place.elevation_deg:g}°"
        residual = _residual_of(identification, position, ball, tool)
        number = identification.numbers[position] if identification.numbers else position
        rows.append((str(number), where, str(ball), f"{residual:.1f}"))
    heads = ("position", "orientation", "ball", "residual / µm")
    return Table(heads, tuple(rows), ("position", "ball", "residual / µm"))


def _residual_of(identification: IdentificationData, position: int, ball: int, tool: int) -> float:
    seen = identification.observations
    row = (seen.position == position) & (seen.ball == ball) & (seen.tool == tool)
    return float(1e3 * np.linalg.norm(identification.residuals_mm[row]))


def fit(identification: IdentificationData) -> Rows:
    estimate = identification.estimate
    misfit = "not estimated"
    if estimate.misfit is not None:
        rms = 1e3 * estimate.misfit.amplitude_mm * estimate.scales.misfit
        misfit = f"about {number(rms, 2)} µm rms not represented by the model"
    return [
        ("Normalised χ²", fixed(estimate.chi2_normalised, 3)),
        ("Degrees of freedom", fixed(estimate.degrees_of_freedom, 0)),
        ("Touch noise", f"{fixed(estimate.scales.noise, 2)} times as stated"),
        (
            "Machine family",
            f"{fixed(estimate.scales.prior, 2)} times as wide as stated; "
            f"error motions {', '.join(fixed(scale, 2) for scale in estimate.scales.independent)} times (X, Y, Z)",
        ),
        ("Model misfit", misfit),
        ("Conditioning", number(estimate.conditioning, 3)),
        ("Rank", f"{estimate.rank} of {estimate.model.size}"),
        ("Rejected balls", str(len(estimate.rejected))),
    ]


def artefact_calibration(calibration: ArtefactCalibration | None) -> dict[str, Any] | None:
    """Return the table and the notes of the ball centres as the run measured them, or None if it yields nothing about
    them."""
    if calibration is None:
        return None
    rows = tuple(
        (str(ball), *(fixed(value, 4) for value in centre), *(fixed(UM_PER_MM * value, 2) for value in uncertainty))
        for ball, (centre, uncertainty) in enumerate(
            zip(calibration.balls.tolist(), calibration.expanded_uncertainty_mm.tolist(), strict=True)
        )
    )
    heads = ("ball", "X / mm", "Y / mm", "Z / mm", "U(X) / µm", "U(Y) / µm", "U(Z) / µm")
    return {"table": Table(heads, rows, heads), "notes": calibration.limits}


def joined_instruments(checks: Sequence[InstrumentCheck]) -> Table | None:
    """Return the table of the other instruments, or None without any: what each read, whether it agrees with the ball
    centres and the other instruments, and whether its readings are part of the estimate."""
    if not checks:
        return None
    rows = tuple(
        (
            check.name,
            check.kind,
            str(check.readings),
            f"{fixed(check.chi2, 1)} / {check.degrees_of_freedom}",
            number(check.false_alarm, 2),
            check.largest.text,
            "contradicts" if check.contradicts else "agrees",
            "yes" if check.joined else "no",
        )
        for check in checks
    )
    heads = (
        "file",
        "instrument",
        "readings",
        "χ² / degrees of freedom",
        "probability",
        "largest difference",
        "result",
        "joined",
    )
    return Table(heads, rows, ("readings", "χ² / degrees of freedom", "probability"))


def null_intro(identification: IdentificationData) -> str:
    size, rank = identification.estimate.model.size, identification.estimate.rank
    if rank == size:
        return f"All {size} parameters of the model are determined by the measurement."
    missing = plural(size - rank, "direction")
    if not identification.family_prior:  # no prior, or that of earlier nights
        return (
            f"The measurement determines {rank} of {size} combinations of parameters. The other {missing} do not "
            "follow from this measurement and have no effect at the measured balls:"
        )
    return (
        f"The measurement determines {rank} of {size} combinations of parameters. The other {missing} follow from the "
        "machine family alone and have no effect at the measured balls:"
    )


def table_rows(identification: IdentificationData) -> Rows | None:
    table = identification.table
    if table is None:
        return None
    largest = ", ".join(f"{axis} {value:.1f}" for axis, value in zip("XYZ", table.largest_um, strict=True))
    x, y, z = table.nodes
    return [
        ("Grid", f"{x} × {y} × {z} nodes"),
        ("Largest correction", f"{largest} µm"),
        ("Anchor", f"zero at {point(table.anchor_mm)}; primary {table.primary}, secondary {table.secondary}"),
        ("Tool offset", point(table.tool_offset_mm)),
        ("Outside the measured region", f"{table.extrapolated} of {table.cells} nodes"),
        ("Sign", "values are added to the commanded position"),
        ("CRC-32 of the CSV file", table.crc32),
    ]


def parameters(identification: IdentificationData) -> list[list[tuple[str, str, str, str]]]:
    """Return the parameters of the error model in columns of rows, `PARAMETER_COLUMNS` of them. Each row contains
    the name, the value, the expanded uncertainty (k = 2) and the unit of a parameter."""
    estimate = identification.estimate
    sigma = estimate.standard_uncertainty
    rows = []
    for parameter, value, spread in zip(estimate.model.parameters, estimate.parameters, sigma, strict=True):
        unit, scale = MICRO_UNITS[parameter.unit]
        rows.append((parameter.name, fixed(scale * value, 2), fixed(COVERAGE * scale * spread, 2), unit))
    height = -(-len(rows) // PARAMETER_COLUMNS)
    return [rows[start : start + height] for start in range(0, len(rows), height)]
