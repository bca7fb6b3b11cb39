"""Gate (limit) for a night whose measurements are combined with those of earlier nights: does it fit their
prediction?"""

from __future__ import annotations

from typing import Any

from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import NIGHT
from agent.results.night_changes import drift_document, jump_documents, possible_text
from agent.settings.schema import GateSettings
from twin.monitoring.night_fit import NightFit


def night_gate(fit: NightFit, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the probability of a night, if the machine drifts as in the nights before."""
    return Gate(NIGHT, fit.fits, fit.probability, limits.night_false_alarm, night_text(fit))


def night_text(fit: NightFit) -> str:
    """Return the comparison of a night with the nights before, in words."""
    figures = (
        f"normalised χ² {fit.chi2_normalised:.2f} against the prediction, drift {fit.factor:.2g} times as stated "
        f"(expected {fit.expected_factor:.2g})"
    )
    if fit.suspect is None:
        return f"probability of such a night after the nights before: {figures}"
    return (
        f"the night does not fit the nights before: {figures}; most likely {possible_text(fit.suspects)}. Check the "
        "machine and the set-up, state a larger process noise, or calibrate in full"
    )


def night_document(fit: NightFit) -> dict[str, Any]:
    """Return the comparison of a night with the nights before as the JSON object that docs/reference/json.md
    describes."""
    suspect = fit.suspect
    return {
        "fits": fit.fits,
        "probability": fit.probability,
        "chi2_normalised": fit.chi2_normalised,
        "drift_factor": fit.factor,
        "drift_factor_expected": fit.expected_factor,
        "likeliest": None if suspect is None else suspect.text,
        "suspects": jump_documents(fit.suspects),
        "drift": drift_document(fit.drift),
    }
