"""Rule of each gate: what it limits, by which setting, and what to do if it is not passed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agent.figures.numbers import significant

CHANGE = "change"
"""Name of the gate that an operator may open by consent, because a machine really changes if it is repaired or has a
collision, and must then be calibrated again."""

FIT = "fit"
"""Name of the gate for the residuals of the ball centres."""

CERTIFICATE = "certificate"
"""Name of the gate for the agreement of the balls with their certificate."""

NIGHT = "night"
"""Name of the gate for a night that is combined with earlier nights."""

STEP = "step in run"
"""Name of the gate for a sudden change of the machine during the measurement."""

PATTERN = "pattern"
"""Name of the gate for shifts of the balls that follow a pattern over all positions, such as lost motion."""

COMMON_SCALE = "common scale"
"""Name of the gate for the scale that all axes have in common relative to the artefact."""

PROBE, PROOF, PROOF_FIT = "probe", "proof", "proof fit"
"""Names of limits that a run meets elsewhere: the check of the probe, and the proof of the new table."""


@dataclass(frozen=True)
class GateRule:
    """Name of what a gate limits with its unit, settings key of the limit, and what to do if a run is expected not to
    pass it.

    `at_least` is True if the value must reach the limit, False if it must not exceed it.
    """

    title: str
    unit: str
    key: str
    remedy: str
    at_least: bool = False

    @property
    def sign(self) -> str:
        """Sign between the value and the limit of a gate that is passed."""
        return "≥" if self.at_least else "≤"

    def sentence(self, found: str, limit: float) -> str:
        """Return the sentence that says what was found, a number or that there is none, and what is required."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.title}: {found}{unit}, required {self.sign} {significant(limit)}{unit}"


_MORE = "measure more positions (`procedure.position_set`, `procedure.stations`; `volcal rank` says which help)"
_FAMILY = "raise the limit, or check `model.family` in the machine file"
_EXPECTED_CHI2 = "set it to more than 1, which is the expected value"

GATE_RULES: Mapping[str, GateRule] = {
    PROBE: GateRule(
        "repeatability of the probe",
        "µm",
        "probe_check.limit_um",
        "set it to twice `procedure.touch_sigma_um` or more, or state there how well the probe repeats",
    ),
    FIT: GateRule("fit of the model", "", "gates.max_chi2", _EXPECTED_CHI2),
    "redundancy": GateRule(
        "redundant measurements", "", "gates.min_degrees_of_freedom", f"{_MORE}, or lower the limit", at_least=True
    ),
    CERTIFICATE: GateRule(
        "contradiction to the certificate, |E_n|",
        "",
        "gates.max_certificate_en",
        "raise the limit; the largest of several right balls reaches this value",
    ),
    STEP: GateRule(
        "change of the machine while measuring, probability",
        "",
        "gates.step_false_alarm",
        "lower the limit, which is a probability",
        at_least=True,
    ),
    PATTERN: GateRule(
        "pattern of shifts, probability",
        "",
        "gates.pattern_false_alarm",
        "lower the limit, which is a probability",
        at_least=True,
    ),
    COMMON_SCALE: GateRule(
        "common scale of the axes, probability",
        "",
        "gates.common_scale_false_alarm",
        "lower the limit, which is a probability",
        at_least=True,
    ),
    CHANGE: GateRule(
        "change since the last accepted night",
        "",
        "gates.max_change",
        "raise the limit; an unchanged machine reaches this value",
    ),
    NIGHT: GateRule(
        "night after the nights before, probability",
        "",
        "gates.night_false_alarm",
        "lower the limit; a night that fits reaches this probability",
        at_least=True,
    ),
    "correction": GateRule("largest correction", "µm", "gates.max_correction_um", _FAMILY),
    "slope": GateRule("steepest correction", "µm/mm", "gates.max_slope_um_per_mm", _FAMILY),
    "extrapolation": GateRule(
        "share outside the measured region",
        "",
        "gates.allow_extrapolation",
        "allow it, or narrow `axes.*.range_mm` in the machine file to the travel that the balls reach",
    ),
    "unmeasured": GateRule(
        "remaining share of the error outside the measured region",
        "",
        "gates.max_unmeasured_fraction",
        f"{_MORE}, narrow `axes.*.range_mm` in the machine file, or raise the limit",
    ),
    "gain": GateRule(
        "gain of the new table",
        "",
        "verification.min_gain",
        f"{_MORE}, or lower the limit; a run would keep the active compensation",
        at_least=True,
    ),
    PROOF: GateRule(
        "power of the proof",
        "",
        "verification.positions",
        "hold out more positions, or touch each ball more often (`procedure.touches_per_ball`); a run would keep the "
        "active compensation",
        at_least=True,
    ),
    PROOF_FIT: GateRule("fit of the proof", "", "verification.max_chi2", _EXPECTED_CHI2),
}
"""Rule of each gate, by its name."""

MORE_POSITIONS = "more positions or another position set lower the predicted VCE; see the report"
BETTER_CERTIFICATE = (
    "clean the named balls and have them calibrated, or list them as uncertified_balls in the artefact file"
)
MACHINE_CHANGED = (
    "look for the cause (a collision, a clamp, a carried artefact, a machine that warms up), and measure again"
)
SHIFTED = (
    "correct it at its cause (the reversal error of an axis, its counterweight, `sag_um` in the artefact file), and "
    "measure again"
)
NOISE_STATED = (
    "state how well the probe repeats (`procedure.touch_sigma_um`, sigma_um of the ball file); if it does, look for a "
    "loose stylus, holder or slide, or correct `model.family` in the machine file; more positions do not help"
)
SCALE_CHECKED = (
    "check the thermometer on the artefact, its certified length and its CTE, and measure again; if it is the machine "
    "that has this scale, for example because it is warm, widen `positioning_um` of `model.family` in the machine file"
)
"""Remedies for gates that a run did not pass: for the gates `CERTIFICATE`, `STEP`, `PATTERN`, `FIT` and `COMMON_SCALE`,
and for all others."""
