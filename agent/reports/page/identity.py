"""Head of the report: the identity of the run, the main results as tiles, and statements on the validity of the
result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.language.sentences import as_it_is
from agent.reports.page.data import IdentificationData, ReportData
from agent.reports.page.number_format import Rows, fixed, micrometres, number, plural, point
from agent.reports.page.texts import Texts
from agent.results.facts import Quantity, unchecked_text
from agent.results.gates.estimate_gates import certificate_score
from twin.artefact.observations import Observations
from twin.artefact.position_set import CHECKABLE_BALLS
from twin.identification import BallCheck
from twin.units import UM_PER_MM


def tiles(data: ReportData, t: Texts) -> list[dict[str, str]]:
    """Return the tiles (boxes) at the top of the report, each with the name and the value of one main result."""
    identification, night = data.identification, data.run.night
    if identification is not None:
        shown = _of_estimate(data, identification, t)
    elif night is not None and night.ve_now_um is not None:
        shown = [
            (t["tile_ve_now"], micrometres(Quantity(night.ve_now_um))),
            (t["tile_ve_before"], micrometres(_quantity(night.ve_before_um))),
            *_of_run(data, t)[:2],
        ]
    else:
        shown = [(t["tile_state"], data.header.end), *_of_run(data, t)]
    return [{"text": text, "value": value} for text, value in shown]


def _of_estimate(data: ReportData, identification: IdentificationData, t: Texts) -> list[tuple[str, str]]:
    proof, estimate = data.run.verification, identification.estimate
    third = (
        (t["tile_chi2"], fixed(estimate.chi2_normalised, 2))
        if proof is None
        else (t["tile_held_out"], micrometres(proof.after))
    )
    return [
        _with_limits(t["tile_before"], identification.volumetric.before_aligned),
        _with_limits(t["tile_after"], identification.volumetric.after_aligned),
        third,
        (t["tile_seen"], t["of_value"].format(value=estimate.rank, all=estimate.model.size)),
    ]


def _with_limits(text: str, quantity: Quantity) -> tuple[str, str]:
    """Return the text and the value of a tile. The limits are in the small print, because the value is set in large
    type.
    """
    value, _, limits = micrometres(quantity).partition(", ")
    return f"{text}; {limits}" if limits else text, value


def _of_run(data: ReportData, t: Texts) -> list[tuple[str, str]]:
    run = data.run
    minutes = "–" if run.machine_minutes is None else f"{fixed(run.machine_minutes, 1)} min"
    return [
        (t["tile_balls"], _count(run.balls)),
        (t["tile_minutes"], minutes),
        (t["tile_touches"], _count(run.touches)),
    ]


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _quantity(value_um: float | None) -> Quantity | None:
    return None if value_um is None else Quantity(value_um)


def identity(data: ReportData) -> Rows:
    artefact, run, identification = data.artefact, data.run, data.identification
    rows = [("Run", data.header.run_id), *run.times]
    if run.provenance is not None:
        rows.append(("Started by", run.provenance.started_by))
    if identification is not None:
        rows += _machine(identification)
    rows += [
        ("Tool offset", f"{data.tool_name} {point(data.tool_offset)}"),
        ("Artefact", f"{as_it_is(artefact.name)}, {artefact.balls} balls of {number(artefact.ball_diameter_mm, 5)} mm"),
    ]
    if identification is not None:
        rows += _certificate_check(identification.estimate.certificate_check)
    rows.append(("Position set", data.header.position_set))
    if identification is not None:
        centres = plural(identification.observations.size, "ball centre")
        measured = f"{centres} in {plural(len(identification.positions), 'position')}"
        rows += [("In the estimate", measured), ("Formulation", identification.estimate.formulation)]
    rows += data.header.settings.items()
    if run.balls is not None:
        rows.append(("Balls measured", str(run.balls)))
    if run.touches is not None:
        rows.append(("Touches", str(run.touches)))
    if run.machine_minutes is not None:
        forecast = "" if run.forecast_minutes is None else f" (forecast {fixed(run.forecast_minutes, 0)} min)"
        rows.append(("Machine time", f"{fixed(run.machine_minutes, 0)} min{forecast}"))
    rows += run.banks
    rows.append(("Software", f"volcal {data.header.software_version}"))
    return rows


def _certificate_check(checks: Sequence[BallCheck]) -> Rows:
    """Return rows on the certified balls and the uncertified ones, compared with the measurements."""
    certified = sorted((check for check in checks if check.certified), key=lambda check: -check.contradiction)
    rows = []
    if certified:
        # |E_n| of ISO 13528: difference over its expanded uncertainty
        worst = ", ".join(
            f"ball {check.ball}: {fixed(certificate_score(check), 1)} along {check.direction}"
            for check in certified[:3]
        )
        rows.append(("Largest contradictions to the certificate", f"{worst} (|E_n|, k = 2, artefact frame)"))
    for check in checks:
        if not check.certified:
            error = ", ".join(fixed(UM_PER_MM * value, 1) for value in check.apparent_error_mm)
            rows.append((f"Ball {check.ball}, uncertified", f"centre estimated; {error} µm from the file in X, Y, Z"))
    return rows


def _machine(identification: IdentificationData) -> Rows:
    model = identification.estimate.model
    ranges = ", ".join(
        f"{axis} {number(low, 6)} to {number(high, 6)}"
        for axis, (low, high) in zip("XYZ", model.ranges_mm, strict=True)
    )
    return [("Kinematic chain", str(model.chain)), ("Workspace", f"{ranges} mm")]


def _unchecked(touches: int | None, seen: Observations) -> list[str]:
    """Return the statement about positions in which a wrong touch cannot be told, if there are any."""
    _, balls = np.unique(seen.position, return_counts=True)
    count = int((balls < CHECKABLE_BALLS).sum())
    if touches is None or count == 0:
        return []
    return [f"Not checked: {unchecked_text(count, len(balls), touches)}."]


def validity(data: ReportData, identification: IdentificationData) -> list[str]:
    """Return statements about the tool offset, about the thermometer of the artefact, about the accuracy after a
    homing, and about the region of the workspace for which the result is valid."""
    seen = identification.observations
    used = [seen.tool_offsets[tool] for tool in np.unique(seen.tool)]
    lengths = " and ".join(point(offset) for offset in used)
    if len(used) == 1:
        first = (
            f"Measured with one tool offset, {lengths}. The result and its table are valid for this offset only: with "
            "another stylus or tool the rotations have a different lever arm, and some could not be determined "
            "separately."
        )
    else:
        first = f"Measured with {len(used)} tool offsets, {lengths}; the table is made for {point(data.tool_offset)}."
    low, high = seen.axis_positions.min(axis=0), seen.axis_positions.max(axis=0)
    spans = ", ".join(f"{axis} {low[i]:.0f} to {high[i]:.0f}" for i, axis in enumerate("XYZ"))
    homing = [f"After a homing: {data.run.after_homing}."] if data.run.after_homing else []
    thermometer = [] if identification.thermometer is None else [identification.thermometer.text]
    return [
        first,
        *thermometer,
        *homing,
        *_unchecked(data.run.touches_checked_together, seen),
        f"Balls were measured at axis positions {spans} mm. Outside of them the model extrapolates.",
        "A common scale error of all certified lengths looks like scale errors of the machine's axes and cannot be "
        "seen with this artefact alone, only with a length measured independently.",
    ]
