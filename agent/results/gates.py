"""Gates (limits) that an estimate and its compensation table must pass before the table is written. All functions are
free of side effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.errors import GateRefused
from agent.figures.numbers import significant
from agent.model_files import load_machine
from agent.results.table_replacement import ExpectedGain
from agent.results.travel_parts import TravelParts
from agent.settings.load import naming, read_settings
from agent.settings.schema import COVERAGE_FACTOR, GateSettings
from drivers.errors import InputError
from drivers.roles import StoreLimits
from twin.artefact.effect_test import REQUIRED_POWER
from twin.compensation.table import CompensationTable
from twin.identification import (
    OUTSIDE_FAMILY,
    BallCheck,
    CommonScale,
    Estimate,
    EstimatedShift,
    PatternTest,
    StepInRun,
)
from twin.units import UM_PER_MM

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


@dataclass(frozen=True)
class Gate:
    """Condition that a result must meet before a compensation table is written.

    `passed` is True if `value` meets `limit`. `text` explains the condition and states the unit of `value` and `limit`.
    """

    name: str
    passed: bool
    value: float
    limit: float
    text: str

    @property
    def figures(self) -> str:
        """Value and limit as a text."""
        return f"{significant(self.value)}, required {GATE_RULES[self.name].sign} {significant(self.limit)}"


def estimate_gates(estimate: Estimate, limits: GateSettings) -> tuple[Gate, ...]:
    """Return the six gates (limits) for the estimate: the fit of the residuals, the number of redundant measurements,
    the agreement of the balls with their certificate, a machine that did not change in the run, balls that are not
    shifted by a pattern, and a common scale that machine and artefact may have."""
    return (
        fit_gate(estimate.chi2_normalised, limits, estimate.scales.of_machine),
        redundancy_gate(estimate.degrees_of_freedom, limits),
        certificate_gate(estimate.certificate_check, limits),
        step_gate(estimate.step, limits),
        pattern_gate(estimate.pattern, limits, estimate.shifts),
        common_scale_gate(estimate.common_scale, limits),
    )


def fit_gate(chi2_normalised: float, limits: GateSettings, times_family: float = 1.0) -> Gate:
    """Return the gate (limit) for the residuals of the ball centres. `times_family` is the factor of the errors of the
    machine on those of its family."""
    text = "normalised χ² of the residuals: the model and the stated noise explain what was measured"
    if chi2_normalised > limits.max_chi2:
        text = f"the ball centres scatter {math.sqrt(chi2_normalised):.1f} times as much as stated"
        if times_family >= OUTSIDE_FAMILY:
            text += f"; the errors of the machine are {times_family:.0f} times those of its family"
    return _gate_below(FIT, chi2_normalised, limits.max_chi2, text)


def redundancy_gate(degrees_of_freedom: float, limits: GateSettings) -> Gate:
    return Gate(
        "redundancy",
        degrees_of_freedom >= limits.min_degrees_of_freedom,
        float(degrees_of_freedom),
        float(limits.min_degrees_of_freedom),
        "degrees of freedom left: enough measurements to notice a wrong one",
    )


def gain_gate(gain: ExpectedGain, min_gain: float) -> Gate:
    """Return the gate (limit) for the relative decrease of the VE that is expected with the new table."""
    return Gate(
        "gain",
        gain.reaches(min_gain),
        gain.fraction,
        min_gain,
        f"relative decrease of the expected VE from {gain.kept_um:.2f} to {gain.new_um:.2f} µm by the new table "
        "(aligned): the improvement must stand out of its uncertainty",
    )


def proof_gate(power: float) -> Gate:
    """Return the gate (limit) for the probability `power` that the proof accepts a table that works."""
    return Gate(
        PROOF,
        power >= REQUIRED_POWER,
        power,
        REQUIRED_POWER,
        "probability that held-out positions prove a table that works; one without effect passes with 5 % at most",
    )


def certificate_gate(checks: Sequence[BallCheck], limits: GateSettings) -> Gate:
    """Return the gate (limit) for the largest contradiction between a ball and its certificate, as the score
    |E_n| of ISO 13528: the difference over its expanded uncertainty (k = 2).

    Balls that the artefact file declares as uncertified are left out. The text names every ball beyond the limit.
    """
    certified = sorted((check for check in checks if check.certified), key=lambda check: -check.contradiction)
    limit = limits.max_certificate_en
    wrong = [check for check in certified if certificate_score(check) > limit]
    if not certified:
        text = "no ball of the artefact has a certificate with an uncertainty that could be tested"
    elif not wrong:
        largest = certified[0]
        text = f"largest contradiction of a ball with its certificate, |E_n| with k = 2: ball {largest.ball}"
    else:
        numbers = ", ".join(str(ball) for ball in sorted(check.ball for check in wrong))
        text = (
            f"{'; '.join(_contradiction(check) for check in wrong)}: clean and calibrate, or state "
            f"uncertified_balls = [{numbers}] in the artefact file"
        )
    value = certificate_score(certified[0]) if certified else 0.0
    return Gate(CERTIFICATE, not wrong, value, limit, text)


def certificate_score(check: BallCheck) -> float:
    """Return the contradiction of a ball with its certificate as the score |E_n| of ISO 13528."""
    return check.contradiction / COVERAGE_FACTOR


def step_gate(step: StepInRun | None, limits: GateSettings) -> Gate:
    """Return the gate (limit) for a sudden change of the machine during the measurement: the probability of such
    measurements, at most, if the machine did not change. The text names the likeliest changes.

    `step` is None if the measurements were not tested for a change.
    """
    clear = "probability of such measurements, at most, on a machine that did not change while it was measured"
    if step is not None and step.hidden is not None:
        clear = f"{clear}; {step.hidden.note}"
    untested = "the measurements were not tested for a change of the machine"
    alarm = "the machine changed while it was measured: "
    return _gate_of_test(STEP, step, limits.step_false_alarm, untested, clear, alarm)


def pattern_gate(pattern: PatternTest | None, limits: GateSettings, estimated: Sequence[EstimatedShift] = ()) -> Gate:
    """Return the gate (limit) for shifts of the balls that follow a pattern over all positions: the probability of such
    measurements, at most, without a pattern. The text names the likeliest causes, and the shifts that were
    `estimated` with the errors of the machine.

    `pattern` is None if the measurements were not tested for a pattern.
    """
    clear = "probability of such measurements, at most, if no shift follows a pattern over all positions"
    if estimated:
        clear = f"{clear}; taken into account: {', '.join(shift.text for shift in estimated)}"
    untested = "the balls were not tested for a pattern of shifts"
    return _gate_of_test(PATTERN, pattern, limits.pattern_false_alarm, untested, clear)


def common_scale_gate(scale: CommonScale | None, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the scale that all axes have in common relative to the artefact: the probability of
    such a scale, at most, if the family of the machine and the stated uncertainties of the artefact are right. The text
    names the errors of the artefact that would explain the scale.

    `scale` is None if the scale was not tested.
    """
    limit = limits.common_scale_false_alarm
    if scale is None:
        return Gate(COMMON_SCALE, True, 1.0, limit, "the common scale of the axes was not tested")
    passed = scale.false_alarm >= limit
    clear = f"probability of such a scale, at most, for a machine and an artefact as stated: {scale.text}"
    return Gate(
        COMMON_SCALE,
        passed,
        scale.false_alarm,
        limit,
        clear if passed else f"{scale.text}; explained by {scale.causes}",
    )


def _gate_of_test(
    name: str, test: StepInRun | PatternTest | None, limit: float, untested: str, clear: str, alarm: str = ""
) -> Gate:
    """Return the gate for the result of a test of the whole set, with the text for each of its outcomes. The likeliest
    causes follow the text `alarm`."""
    if test is None:
        return Gate(name, True, 1.0, limit, untested)
    if test.false_alarm >= limit:
        return Gate(name, True, test.false_alarm, limit, clear)
    suspects = "; or ".join(f"{one.text} ({100.0 * one.probability:.0f} %)" for one in test.suspects)
    return Gate(name, False, test.false_alarm, limit, f"{alarm}{suspects}")


def _contradiction(check: BallCheck) -> str:
    x, y, z = (UM_PER_MM * value for value in check.apparent_error_mm)
    return (
        f"ball {check.ball} contradicts its certificate along {check.direction}, |E_n| = "
        f"{certificate_score(check):.2f} (k = 2, artefact frame; apparent error X {x:.1f}, Y {y:.1f}, Z {z:.1f} µm)"
    )


def change_gate(change_um: float, expected_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the change of the machine's error field since the last accepted night.

    `change_um` is the rms of the change over the workspace after removal of the best-fitting rigid motion.
    `expected_um` is the rms that is expected from the uncertainties and from the drift since that night.
    """
    return _gate_below(
        CHANGE,
        _share(change_um, expected_um),
        limits.max_change,
        f"change against the last accepted night, {change_um:.2f} µm, in units of its uncertainty {expected_um:.2f} µm",
    )


def table_gates(
    table: CompensationTable, travel: TravelParts, store: StoreLimits, limits: GateSettings
) -> tuple[Gate, ...]:
    """Return the gates (limits) that `table` must pass before it is written to the controller. `travel` contains the
    volumetric error with and without the table outside the measured region."""
    part = travel.unmeasured
    return (
        *shape_gates(table, store, limits),
        extrapolation_gate(float(np.mean(table.extrapolated)), limits),
        unmeasured_gate(*((0.0, 0.0) if part is None else (part.table_ve_um, part.predicted_vce_um)), limits),
    )


def shape_gates(table: CompensationTable, store: StoreLimits, limits: GateSettings) -> tuple[Gate, ...]:
    """Return the two gates (limits) for the values of the table: one limits the largest correction, the other the
    steepest slope."""
    largest_um = float(np.abs(table.corrections).max()) * UM_PER_MM
    return (
        correction_gate(largest_um, store.max_correction_mm * UM_PER_MM, limits),
        slope_gate(_largest_slope_um_per_mm(table), limits),
    )


def correction_gate(largest_um: float, store_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the largest correction. `store_um` is the largest correction that the controller
    accepts."""
    allowed_um = min(limits.max_correction_um, store_um)
    return _gate_below("correction", largest_um, allowed_um, "largest correction of one axis in µm")


def slope_gate(slope_um_per_mm: float, limits: GateSettings) -> Gate:
    return _gate_below(
        "slope", slope_um_per_mm, limits.max_slope_um_per_mm, "steepest change between neighbouring nodes in µm/mm"
    )


def extrapolation_gate(outside: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the fraction `outside` of the table's nodes that lie outside the measured region."""
    return _gate_below(
        "extrapolation",
        outside,
        1.0 if limits.allow_extrapolation else 0.0,
        "share of nodes outside the measured region, where only the prior and the polynomials speak",
    )


def unmeasured_gate(before_um: float, after_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the predicted VCE `after_um` outside the measured region as a share of the VE
    `before_um` that the table corrects there. Both are 0 if the whole travel was measured."""
    return _gate_below(
        "unmeasured",
        0.0 if after_um == 0.0 else _share(after_um, before_um),
        limits.max_unmeasured_fraction,
        f"outside the measured region, predicted VCE {after_um:.2f} µm as a share of the VE {before_um:.2f} µm that "
        "the table corrects there: the corrections must be larger than their uncertainty",
    )


def _gate_below(name: str, value: float, limit: float, text: str) -> Gate:
    return Gate(name, value <= limit, value, limit, text)


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else float("inf")


def with_consent(gates: Sequence[Gate]) -> list[Gate]:
    """Return `gates` with the gate `CHANGE` (limit of the machine's change) marked as passed. The operator must have
    consented to the change of the machine."""
    return [
        replace(gate, passed=True, text=f"{gate.text}; consented") if gate.name == CHANGE and not gate.passed else gate
        for gate in gates
    ]


def names_of_failed(gates: Sequence[Gate]) -> tuple[str, ...]:
    return tuple(gate.name for gate in gates if not gate.passed)


def reasons(gates: Sequence[Gate]) -> str:
    """Return a text that names every one of `gates` that was not passed, with its value and its limit."""
    return "; ".join(
        f"{rule.sentence(significant(gate.value), gate.limit)} ({rule.key}; {gate.text})"
        for gate in gates
        if not gate.passed
        for rule in (GATE_RULES[gate.name],)
    )


def require_passed(gates: Sequence[Gate], consent: str = "") -> None:
    """Raise GateRefused if one of `gates` was not passed. The message names every such gate and ends with a remedy and
    `consent`, a sentence on what to do otherwise."""
    if names_of_failed(gates):
        failed = names_of_failed(gates)
        remedies = {
            CERTIFICATE: BETTER_CERTIFICATE,
            STEP: MACHINE_CHANGED,
            PATTERN: SHIFTED,
            FIT: NOISE_STATED,
            COMMON_SCALE: SCALE_CHECKED,
        }
        remedy = next((text for name, text in remedies.items() if name in failed), MORE_POSITIONS)
        raise GateRefused(f"no table was written: {reasons(gates)}", hint=f"{remedy}{consent}")


def require_unmarked(table: CompensationTable, file: str) -> None:
    """Raise GateRefused if `table`, read from `file`, carries the mark that it was written although gates had not been
    passed."""
    if table.gates_not_passed:
        raise GateRefused(
            f"the table was written although it did not pass the gates {', '.join(table.gates_not_passed)}",
            hint="the report beside it says why; `--even-so` uses the table all the same",
        ).at(file=file)


def require_machine(table: CompensationTable, config: Path, file: str) -> None:
    """Raise InputError if `table`, read from `file`, corrects a machine other than that of the settings file `config`.
    A table that does not name its machine is accepted."""
    with naming(config):
        machine = load_machine(read_settings(config).machine).name
    if table.machine and table.machine != machine:
        raise InputError(
            f"the table corrects the machine {table.machine}, but the settings are those of the machine {machine}",
            hint=f"take a table of {machine}, or name the settings of {table.machine} with --config",
            file=file,
        )


def _largest_slope_um_per_mm(table: CompensationTable) -> float:
    steepest = 0.0
    for axis, nodes in enumerate((table.x, table.y, table.z)):
        change = np.abs(np.diff(table.corrections, axis=axis))
        spacing = np.diff(nodes).reshape([-1 if i == axis else 1 for i in range(4)])
        steepest = max(steepest, float((change / spacing).max(initial=0.0)))
    return steepest * UM_PER_MM
