"""Results of the checks of probe and stylus, in the form that a report shows."""

from __future__ import annotations

import numpy as np

from agent.probing.preparation import PreparationResult
from agent.probing.qualification import Qualification
from agent.results.facts import ProbeFacts, ProbeRing
from twin.arrays import Array
from twin.artefact.pretravel import direction_at
from twin.artefact.touch_pattern import perpendiculars
from twin.units import UM_PER_MM

MAP_STEP_DEG = 3.0


def probe_facts(prepared: PreparationResult | None) -> ProbeFacts | None:
    """Return the results of the checks before the run; None if no check was made."""
    if prepared is None:
        return None
    made = check_rows(prepared)
    datum = () if prepared.datum is None else (("Datum ball", prepared.datum.text),)
    if prepared.qualification is None:
        return ProbeFacts((*datum, *made)) if made else None
    return ProbeFacts((*datum, *made), _rings(prepared.qualification, prepared.rules.probing.stylus_axis))


def check_rows(prepared: PreparationResult) -> tuple[tuple[str, str], ...]:
    """Return the name and the result of each check that was made, as texts."""
    checks = (
        ("Repeatability", prepared.repeatability),
        ("Delay of the latch", prepared.latch),
        ("Stylus", prepared.qualification),
        ("Reversal of the axes", prepared.reversal),
    )
    return tuple((name, check.text) for name, check in checks if check is not None)


def _rings(found: Qualification, stylus_axis: Array) -> tuple[ProbeRing, ...]:
    """Return the touches of the qualification grouped by latitude, the pole first."""
    first, second = perpendiculars(stylus_axis)
    normals = -found.directions
    latitude = np.degrees(np.arcsin(np.clip(found.directions @ stylus_axis, -1.0, 1.0)))
    angle = np.degrees(np.arctan2(normals @ second, normals @ first)) % 360.0
    rounded = np.round(latitude, 6)
    return tuple(
        ProbeRing(
            float(value),
            angle[rounded == value],
            found.residuals_um[rounded == value],
            *_along(found, stylus_axis, float(value)),
        )
        for value in sorted(set(rounded.tolist()), reverse=True)
    )


def _along(found: Qualification, stylus_axis: Array, latitude_deg: float) -> tuple[Array, Array]:
    """Return angles about the stylus (m,) in degrees and the pretravel (m,) in µm at them; empty if there is no map."""
    pretravel = found.stylus.pretravel
    if pretravel is None:
        return np.empty(0), np.empty(0)
    angles_deg = np.arange(0.0, 360.0 + MAP_STEP_DEG, MAP_STEP_DEG)
    latitude = np.radians(latitude_deg)
    around = np.array([direction_at(stylus_axis, latitude, angle) for angle in np.radians(angles_deg)])
    return angles_deg, pretravel.offsets_mm(around) * UM_PER_MM
