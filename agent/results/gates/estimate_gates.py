"""Gates that an estimate must pass. All functions are free of side effects."""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.results.gates.gate import Gate, gate_below, share_of
from agent.results.gates.gate_rules import CERTIFICATE, CHANGE, COMMON_SCALE, FIT, PATTERN, STEP
from agent.settings.schema import COVERAGE_FACTOR, GateSettings
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
    return gate_below(FIT, chi2_normalised, limits.max_chi2, text)


def redundancy_gate(degrees_of_freedom: float, limits: GateSettings) -> Gate:
    return Gate(
        "redundancy",
        degrees_of_freedom >= limits.min_degrees_of_freedom,
        float(degrees_of_freedom),
        float(limits.min_degrees_of_freedom),
        "degrees of freedom left: enough measurements to notice a wrong one",
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


def change_gate(change_um: float, expected_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the change of the machine's error field since the last accepted night.

    `change_um` is the rms of the change over the workspace after removal of the best-fitting rigid motion.
    `expected_um` is the rms that is expected from the uncertainties and from the drift since that night.
    """
    return gate_below(
        CHANGE,
        share_of(change_um, expected_um),
        limits.max_change,
        f"change against the last accepted night, {change_um:.2f} µm, in units of its uncertainty {expected_um:.2f} µm",
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
