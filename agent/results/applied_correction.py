"""Diagnosis of the correction that a controller applies, if held-out balls do not agree with a new table.

Let c be the corrections of the new table, which make up for the estimated deviations: e = -c. A controller that adds
the correction a to the displayed positions d moves the tip to d + a + e = d + a - c. With a = c a ball is met where it
is displayed. The other corrections that controllers are known to apply by mistake are tried in turn: a = -c (wrong
sign), a = 0 (no table), and that of the former table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.probing.position import MeasuredBall
from agent.results.observations import Correction, no_correction, observations_of
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.held_out_check import held_out_residuals
from twin.units import UM_PER_MM

CLEARLY_BETTER = 0.5
"""A mistake is reported if it leaves at most this fraction of the residuals: the other half would be a coincidence."""


def mistaken_correction(
    balls: Sequence[MeasuredBall], new: Correction, former: Correction, tool_offset_mm: Array, artefact: Artefact
) -> str:
    """Return the mistake of the controller that explains the held-out `balls`, which were measured with the new table
    active; empty if none explains them. `new` and `former` are the corrections of the new and of the former table."""
    displayed = np.array([ball.found.centre_mm for ball in balls])
    observed = observations_of(balls, tool_offset_mm, no_correction)
    wanted = new(displayed)
    as_wanted_mm, *others_mm = (
        held_out_residuals(observed, displayed + tool_offset_mm + applied - wanted, artefact).rms_mm
        for applied in (wanted, -wanted, np.zeros_like(wanted), former(displayed))
    )
    best = int(np.argmin(others_mm))
    if others_mm[best] > CLEARLY_BETTER * as_wanted_mm:
        return ""
    return f"{_MISTAKES[best]} (the balls then agree to {UM_PER_MM * others_mm[best]:.2f} µm)"


_MISTAKES = (
    "the correction acts the wrong way: check the sign with which the controller adds the table",
    "the table has no effect: the controller stores it, but does not apply it",
    "the former table still acts: the controller has not activated the new one",
)
