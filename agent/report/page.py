"""The words and numbers of the page, section by section."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from agent.report.data import Quantity, ReportData, Verification, VolumetricSummary
from agent.report.figures import ball_residuals
from agent.report.run_figures import draw_verification
from agent.report.volumetric_summary import volumetric_summary
from agent.report.wording import COVERAGE, Table, fixed, micrometres, number, plural, point
from twin.error_model import SQUARENESS

Rows = list[tuple[str, str]]

GOOD_STATES = ("complete", "idle", "held")
INFORMATIVE_GATES = "For information: there is no machine here that the gates would have to protect."


def page_values(data: ReportData) -> dict[str, Any]:
    """Every value that the template names, except the figures."""
    summary = data.volumetric or volumetric_summary(data.estimate, data.tool_offset)
    failed = [gate for gate in data.gates if not gate.passed] if data.gates_enforced else []
    proof = data.run.verification
    return {
        "header": data.header,
        "machine": data.machine.name,
        "date": data.header.timestamp.replace("T", " ")[:16] + " UTC",
        "state": data.header.state if not failed else f"{data.header.state}, {plural(len(failed), 'gate')} not passed",
        "good": data.header.state in GOOD_STATES and not failed and (proof is None or proof.accepted),
        "tiles": _tiles(data, summary),
        "identity": _identity(data),
        "warnings": data.warnings,
        "summary": _summary_table(data, summary),
        "validity": _validity(data),
        "verification": _verification(proof),
        "probe": data.run.probe.rows if data.run.probe else (),
        "squareness": _squareness(data),
        "residual_note": _residual_note(data),
        "rejected": _rejected(data),
        "temperature_note": _temperature_note(data),
        "fit": _fit(data),
        "null_intro": _null_intro(data),
        "null_directions": data.estimate.null_summary,
        "gates": _gates(data),
        "gate_note": "" if data.gates_enforced else INFORMATIVE_GATES,
        "table": _table(data),
        "events": _events(data),
        "parameters": _parameters(data),
    }


def _tiles(data: ReportData, summary: VolumetricSummary) -> list[dict[str, str]]:
    proof = data.run.verification
    tiles = [
        ("volumetric error of the bare machine, aligned", micrometres(summary.before_aligned)),
        ("predicted after compensation, aligned", micrometres(summary.after_aligned)),
    ]
    if proof is not None:
        tiles.append(("measured after compensation, held-out balls", micrometres(proof.after)))
    else:
        tiles.append(("normalised χ² of the fit", fixed(data.estimate.chi2_normalised, 2)))
    tiles.append(("parameters seen by the measurement", f"{data.estimate.rank} of {data.estimate.model.size}"))
    return [{"text": text, "value": value} for text, value in tiles]


def _identity(data: ReportData) -> Rows:
    model, artefact, run = data.estimate.model, data.artefact, data.run
    ranges = ", ".join(
        f"{axis} {number(low, 6)} to {number(high, 6)}"
        for axis, (low, high) in zip("XYZ", model.ranges_mm, strict=True)
    )
    rows = [
        ("Run", data.header.run_id),
        ("Kinematic chain", str(model.chain)),
        ("Workspace", f"{ranges} mm"),
        ("Tool offset", f"{data.tool_name} {point(data.tool_offset)}"),
        ("Artefact", f"{artefact.name}, {len(artefact.balls)} balls"),
        ("Certificate", artefact.certificate),
        ("Position set", data.header.position_set),
        ("Measured", f"{plural(data.observations.size, 'ball centre')} in {plural(len(data.positions), 'position')}"),
        ("Formulation", data.estimate.formulation),
        *((name, value) for name, value in data.header.settings.items()),
    ]
    if run.touches is not None:
        rows.append(("Touches", str(run.touches)))
    if run.machine_minutes is not None:
        rows.append(("Machine time", f"{fixed(run.machine_minutes, 0)} min"))
    if run.table_bank is not None:
        rows.append(("Active table bank", run.table_bank))
    rows.append(("Software", f"volcal {data.header.software_version}"))
    return rows


def _summary_table(data: ReportData, summary: VolumetricSummary) -> Table:
    rows: list[tuple[str, Quantity | None, Quantity | None]] = [
        ("VE estimated, VCE predicted; aligned", summary.before_aligned, summary.after_aligned),
        ("the same as defined, not aligned", summary.before_raw, summary.after_raw),
    ]
    proof = data.run.verification
    if proof is not None:
        rows.append(("rms at held-out balls, measured", proof.before, proof.after))
    cells = tuple((name, micrometres(before), micrometres(after)) for name, before, after in rows)
    return Table(("quantity", "before", "after"), cells, ("before", "after"))


def _validity(data: ReportData) -> list[str]:
    offsets = data.observations.tool_offsets
    used = [offsets[tool] for tool in np.unique(data.observations.tool)]
    lengths = " and ".join(point(offset) for offset in used)
    if len(used) == 1:
        first = (
            f"Measured with one tool offset, {lengths}. The result and its table hold for this offset only: with "
            "another stylus or tool the rotations act on another arm, and some of them were not seen apart."
        )
    else:
        first = f"Measured with {len(used)} tool offsets, {lengths}; the table is made for {point(data.tool_offset)}."
    low, high = data.observations.axis_positions.min(axis=0), data.observations.axis_positions.max(axis=0)
    spans = ", ".join(f"{axis} {low[i]:.0f} to {high[i]:.0f}" for i, axis in enumerate("XYZ"))
    return [first, f"Balls were found between axis positions {spans} mm; elsewhere the model goes on by itself."]


def _verification(proof: Verification | None) -> dict[str, Any] | None:
    if proof is None:
        return None
    rows = (
        ("before (table inactive)", micrometres(proof.before)),
        ("after (new table active)", micrometres(proof.after)),
        ("predicted uncertainty, 1σ", f"{number(proof.predicted_um, 3)} µm"),
    )
    figure = Markup(draw_verification(proof.positions)) if proof.positions else ""  # noqa: S704  drawn by ourselves
    table = Table(("rms at the held-out balls", "value"), rows, ("value",))
    return {"accepted": proof.accepted, "verdict": proof.verdict, "table": table, "figure": figure}


def _squareness(data: ReportData) -> Table:
    estimate = data.estimate
    places = [estimate.model.index(name) for name in SQUARENESS]
    sigma = estimate.standard_uncertainty
    rows = tuple(
        (name, fixed(1e6 * estimate.parameters[i], 2), fixed(COVERAGE * 1e6 * sigma[i], 2))
        for name, i in zip(SQUARENESS, places, strict=True)
    )
    return Table(("error", "µrad", "±2σ"), rows, ("µrad", "±2σ"))


def _residual_note(data: ReportData) -> str:
    kept = ball_residuals(data).kept
    rms = 1e3 * np.sqrt(np.mean(data.estimate.residuals_mm[kept] ** 2, axis=0))
    text = f"rms by component: x {rms[0]:.2f}, y {rms[1]:.2f}, z {rms[2]:.2f} µm over the balls that were kept"
    return f"{text}. Dotted lines part the stations." if len({p.station for p in data.positions}) > 1 else f"{text}."


def _rejected(data: ReportData) -> Table | None:
    if not data.estimate.rejected:
        return None
    rows = []
    for position, ball, tool in data.estimate.rejected:
        place = data.positions[position]
        where = f"station {place.station}, azimuth {place.azimuth_deg:g}°, elevation {place.elevation_deg:g}°"
        residual = _residual_of(data, position, ball, tool)
        rows.append((str(position), where, str(ball), f"{residual:.1f}"))
    heads = ("position", "orientation", "ball", "residual / µm")
    return Table(heads, tuple(rows), ("position", "ball", "residual / µm"))


def _residual_of(data: ReportData, position: int, ball: int, tool: int) -> float:
    seen = data.observations
    row = (seen.position == position) & (seen.ball == ball) & (seen.tool == tool)
    return float(1e3 * np.linalg.norm(data.estimate.residuals_mm[row]))


def _temperature_note(data: ReportData) -> str:
    temperature = data.observations.temperature_c
    return (
        f"Artefact between {temperature.min():.2f} and {temperature.max():.2f} °C "
        f"(reference {data.artefact.reference_temperature_c:g} °C); its expansion is taken into account with "
        f"{1e6 * data.artefact.cte_per_k:.2f} ± {1e6 * data.artefact.cte_standard_uncertainty_per_k:.2f} µm/(m·K)."
    )


def _fit(data: ReportData) -> Rows:
    estimate = data.estimate
    misfit = "not looked for"
    if estimate.misfit is not None:
        rms = 1e3 * estimate.misfit.amplitude_mm * estimate.scales.misfit
        misfit = f"about {number(rms, 2)} µm rms that the model cannot represent"
    return [
        ("Normalised χ²", fixed(estimate.chi2_normalised, 3)),
        ("Degrees of freedom", fixed(estimate.degrees_of_freedom, 0)),
        ("Touch noise", f"{fixed(estimate.scales.noise, 2)} times as stated"),
        ("Family", f"{fixed(estimate.scales.prior, 2)} times as wide as stated"),
        ("Beside the model", misfit),
        ("Conditioning", number(estimate.conditioning, 3)),
        ("Rank", f"{estimate.rank} of {estimate.model.size}"),
        ("Rejected balls", str(len(estimate.rejected))),
    ]


def _null_intro(data: ReportData) -> str:
    size, rank = data.estimate.model.size, data.estimate.rank
    if rank == size:
        return f"All {size} parameters of the model are seen."
    missing = plural(size - rank, "direction")
    return (
        f"Of {size} parameters {rank} combinations are seen. The other {missing} are held by the family of the machine "
        "alone; they change nothing at the balls that were measured:"
    )


def _gates(data: ReportData) -> list[dict[str, Any]]:
    return [
        {
            "name": gate.name,
            "text": gate.text,
            "value": number(gate.value, 3),
            "limit": "none" if np.isinf(gate.limit) else number(gate.limit, 3),
            "passed": gate.passed,
        }
        for gate in data.gates
    ]


def _table(data: ReportData) -> Rows | None:
    table = data.table
    if table is None:
        return None
    largest = 1e3 * np.abs(table.corrections).max(axis=(0, 1, 2))
    cells, beyond = table.extrapolated.size, int(table.extrapolated.sum())
    anchor = table.anchor
    rows = [
        ("Grid", f"{len(table.x)} × {len(table.y)} × {len(table.z)} nodes"),
        (
            "Largest correction",
            ", ".join(f"{axis} {value:.1f}" for axis, value in zip("XYZ", largest, strict=True)) + " µm",
        ),
        ("Anchor", f"zero at {point(anchor.point_mm)}; primary {anchor.primary}, secondary {anchor.secondary}"),
        ("Tool offset", point(table.tool_offset)),
        ("Beyond the measured region", f"{beyond} of {cells} nodes"),
        ("Sign", "values are added to the commanded position"),
    ]
    if data.table_crc32 is not None:
        rows.append(("CRC-32", data.table_crc32))
    return rows


def _events(data: ReportData) -> Table | None:
    if not data.run.events:
        return None
    rows = tuple((event.timestamp.replace("T", " ")[:19], event.kind, event.text) for event in data.run.events)
    return Table(("time (UTC)", "kind", "event"), rows)


def _parameters(data: ReportData) -> list[list[tuple[str, str, str, str]]]:
    """Three columns of name, value, σ, unit."""
    estimate = data.estimate
    sigma = estimate.standard_uncertainty
    rows = []
    for parameter, value, spread in zip(estimate.model.parameters, estimate.parameters, sigma, strict=True):
        scale, unit = (1e3, "µm") if parameter.unit == "mm" else (1e6, "µrad")
        rows.append((parameter.name, fixed(scale * value, 2), fixed(scale * spread, 2), unit))
    height = -(-len(rows) // 3)
    return [rows[start : start + height] for start in range(0, len(rows), height)]
