"""Replacement of the active compensation table by a new one: the one rule of full calibrations and nights.

The active table is kept unless the new table is expected to be better by a stated margin, and its proof is expected to
show this. If the active table is kept, nothing is written and it is confirmed. A new table must show its effect at the
held-out balls, and they must be as predicted; otherwise the former table is restored.

Let e be the true deviation of the machine, ê its estimate with the covariance C, and c₀ and c₁ the corrections of the
active and of the new table. The mean square that is left is expected to be |ê + c₀|² + tr C with the active table, and
|ê + c₁|² + tr C with the new one. Both corrections are those that the controller applies: c₁ is -ê only at the nodes of
the table, and only to the resolution with which the controller stores it. The proof, its probability of acceptance and
its probability of error are those of `twin.artefact.effect_test`, with the change c₀ - c₁ of the displayed positions.

A controller may store a table and apply something else: nothing, a part, another sign, other axes, or the nodes in
another order. The change of the held-out balls shows this free of the errors of the machine and of the certificate
(`agent.results.applied_table`). A table that is not applied as written is not proved, even if it reduces the errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.errors import MeasurementFault
from agent.files import translated
from agent.planning.job import Job
from agent.probing.measured_balls import Correction, MeasuredBall, observations_of
from agent.probing.run_plan import MeasuredPositions
from agent.results.applied_table import AppliedTable, applied_table
from agent.results.estimation import EstimationResult
from agent.results.observations import ReferenceArtefact, balls_for_estimate, certified_balls, displayed_residuals
from agent.results.run_outcome import Confirmation, Proof
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.change_test import ChangeTest
from twin.artefact.effect_test import EffectTest, MeasuredEffect
from twin.artefact.held_out_check import HeldOutCovariance, HeldOutResiduals, held_out_residuals, projected_touches
from twin.artefact.observations import Observations
from twin.identification import Estimate, residual_covariance
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid, volumetric_error
from twin.units import UM_PER_MM

_GRID, _COARSE_GRID = (24, 12, 12), (12, 8, 8)  # of the travel; the fields are smooth


@dataclass(frozen=True)
class ExpectedGain:
    """Volumetric errors (VE) in µm, after removal of the best-fitting rigid motion, that are expected with the active
    table (`kept_um`) and with a new table (`new_um`)."""

    kept_um: float
    new_um: float

    @property
    def fraction(self) -> float:
        """Relative decrease of the volumetric error by the new table."""
        return 1.0 - self.new_um / self.kept_um if self.kept_um > 0.0 else 0.0

    def reaches(self, min_gain: float) -> bool:
        """Return True if the new table is expected to be better by the margin `min_gain`."""
        return self.fraction >= min_gain


def expected_gain(
    estimate: Estimate, unknown_um: float, former: Correction, new: Correction, tool_offset_mm: Array
) -> ExpectedGain:
    """Return the errors expected from `estimate` with the corrections `former` of the active table and `new` of the new
    one, both as the controller applies them. `unknown_um` is the error in µm that is left if all estimated errors are
    corrected."""
    grid = evaluation_grid(estimate.model.ranges_mm, _GRID)
    points, field = grid + tool_offset_mm, _field(estimate, grid, tool_offset_mm)
    kept_um, new_um = (
        math.hypot(volumetric_error(points, field + correction(grid)).aligned_um, unknown_um)
        for correction in (former, new)
    )
    return ExpectedGain(kept_um, new_um)


@dataclass(frozen=True, eq=False)
class FormerBalls:
    """Held-out balls measured with the former table, whose corrections are `correction`, in the course of the
    measurement from which the estimate was made.

    `observed` are their observations without compensation. `drift_mm` (n, 3) is the deviation of each ball when it was
    measured, minus its deviation at the end of that measurement. The estimate describes the state of the machine at the
    end.
    """

    balls: Sequence[MeasuredBall]
    correction: Correction
    observed: Observations
    drift_mm: Array

    @classmethod
    def of(
        cls, job: Job, estimation: EstimationResult, measured: MeasuredPositions, correction: Correction
    ) -> FormerBalls:
        """Return the held-out balls in `measured`. Raises MeasurementFault if none was measured."""
        reference = estimation.reference(job.artefact)
        balls = _certified(reference, job.balls_of(measured, held_out=True), " with the former table active")
        drift_mm = earlier_deviations(
            job, measured, balls, estimation.estimate, estimation.observations.thermal_regressors
        )
        return cls(balls, correction, observations_of(balls, job.tool_offset_mm, correction), drift_mm)

    def paired(self, after: Sequence[MeasuredBall]) -> tuple[FormerBalls, list[MeasuredBall]]:
        """Return the balls that were measured again in `after`, and those measured again, in the same order. Raises
        MeasurementFault if there is none."""
        again = {_place(ball): ball for ball in after}
        known = np.array([_place(ball) in again for ball in self.balls])
        if not known.any():
            raise MeasurementFault("no ball of a held-out position was measured with both tables active")
        balls = [ball for ball in self.balls if _place(ball) in again]
        former = FormerBalls(balls, self.correction, self.observed.select(known), self.drift_mm[known])
        return former, [again[_place(ball)] for ball in balls]

    def residuals(self, tool_offset_mm: Array, artefact: Artefact) -> HeldOutResiduals:
        """Return the residuals that the balls would show at the end of the measurement with the former table active.

        The displayed position of a ball is its true position minus the deviation, so it rises by the amount by which
        the deviation falls.
        """
        displayed = np.array([ball.found.centre_mm for ball in self.balls])
        return held_out_residuals(self.observed, displayed + tool_offset_mm + self.drift_mm, artefact)


def earlier_deviations(
    job: Job, measured: MeasuredPositions, balls: Sequence[MeasuredBall], estimate: Estimate, regressors: Array
) -> Array:
    """Return the deviations (n, 3) in mm of the machine at the time when the n `balls` were measured, minus those in
    the state that `estimate` describes, which is the end of the measurement. They are zero if the estimate contains no
    drift.

    `regressors` (m, w) contains the thermal regressors in K of the m balls in `measured` from which the estimate was
    made.
    """
    positions = np.array([ball.found.centre_mm for ball in balls])
    if estimate.drift is None:
        return np.zeros_like(positions)
    known_s = np.array([ball.conditions.instant_s for ball in balls_for_estimate(job, measured)])
    instants_s, by_time = [ball.conditions.instant_s for ball in balls], np.argsort(known_s)
    course = [np.interp(instants_s, known_s[by_time], column[by_time]) for column in regressors.T]
    basis = deviation_basis(estimate.model, positions, job.tool_offset_mm)
    return estimate.drift.deviations(basis, np.stack(course, axis=1) - regressors[-1])


def proof_power(job: Job, estimation: EstimationResult, former: FormerBalls) -> float:
    """Return the probability that the proof accepts the table of `estimation`, as the controller applies it, if it
    works. The held-out balls `former` were measured with the active table. Raises MeasurementFault if too few were
    measured."""
    reference, offset = estimation.reference(job.artefact), job.tool_offset_mm
    with translated(MeasurementFault):
        result = former.residuals(offset, reference.artefact)
        residuals = _residual_covariance(reference, estimation, former.observed, result, offset)
    touches_before = _touches_before(former, residuals)
    return _effect_test(job, estimation, former, residuals, touches_before).power(result.residuals_mm)


def _touches_before(former: FormerBalls, residuals: HeldOutCovariance) -> Array:
    """Return the projected covariance (f, f) in mm² of the touches of the balls with the former table."""
    return projected_touches(residuals.basis, former.observed.covariance)


def _effect_test(
    job: Job,
    estimation: EstimationResult,
    former: FormerBalls,
    residuals: HeldOutCovariance,
    touches_before: Array,
) -> EffectTest:
    corrections = [_correction_at(former.balls, correction) for correction in (former.correction, estimation.table.at)]
    return EffectTest.of(
        residuals.projected(corrections[0] - corrections[1]),
        residuals,
        touches_before,
        estimation.estimate.scales.noise,
        job.settings.verification.max_chi2,
    )


def _applied_table(
    job: Job,
    estimation: EstimationResult,
    former: FormerBalls,
    residuals: HeldOutCovariance,
    touches_before: Array,
    change_mm: Array,
) -> AppliedTable:
    """Return which correction the controller applies, from the change (n, 3) in mm of the residuals of the held-out
    balls."""

    def projected(correction: Correction) -> Array:
        return residuals.projected(_correction_at(former.balls, correction))

    change = residuals.projected(change_mm) - projected(former.correction)
    test = ChangeTest.of(change, residuals, touches_before, estimation.estimate.scales.noise)
    return applied_table(test, estimation.table, former.correction, projected, job.settings.verification.max_chi2)


def confirm(
    job: Job, estimation: EstimationResult, gain: ExpectedGain, power: float | None, former: FormerBalls
) -> Confirmation:
    """Return the confirmation of the active table, with which the held-out balls `former` were measured. `power` is
    that of the proof of a new table, None if none would be better by the margin.

    The confirmation relies on the estimate. The ball centres, corrected by the estimate, must therefore agree with
    their prediction; otherwise the reason of the confirmation is not empty. Raises MeasurementFault if too few
    held-out balls were measured.
    """
    limits, offset = job.settings.verification, job.tool_offset_mm
    reference = estimation.reference(job.artefact)
    with translated(MeasurementFault):
        bare = former.observed
        field = _field(estimation.estimate, bare.axis_positions, offset)
        points = bare.axis_positions + offset + field + former.drift_mm
        result = held_out_residuals(bare, points, reference.artefact)
        expected = _residual_covariance(reference, estimation, bare, result, offset).test(result.residuals_mm)
        measured_um = UM_PER_MM * displayed_residuals(former.balls, offset, reference.artefact).rms_mm
    return Confirmation(
        kept_um=gain.kept_um,
        new_um=gain.new_um,
        min_gain=limits.min_gain,
        held_out_um=measured_um,
        chi2_normalised=expected.chi2_normalised,
        power=power,
        reason=_disagreement(expected.chi2_normalised, limits.max_chi2),
    )


def prove(job: Job, estimation: EstimationResult, former: FormerBalls, after: Sequence[MeasuredBall]) -> Proof:
    """Return the proof of a new compensation table at the held-out balls that were measured both with the former table,
    `former`, and with the new one, `after`. The table of `estimation` is the one that the controller applies.

    If the machine drifted, the residuals with the former table are first converted to the state of the machine at the
    end of the measurement. Otherwise an error that grew during the measurement would hide the effect of the table, and
    one that shrank would be mistaken for it. Raises MeasurementFault if too few balls were found for a comparison.
    """
    offset = job.tool_offset_mm
    reference = estimation.reference(job.artefact)
    former, after = former.paired(_certified(reference, after, " with the new table active"))
    with translated(MeasurementFault):
        seen = observations_of(after, offset, estimation.table.at)
        before, result = (displayed_residuals(balls, offset, reference.artefact) for balls in (former.balls, after))
        residuals = _residual_covariance(reference, estimation, seen, result, offset)
        undrifted = former.residuals(offset, reference.artefact)
    touches_before = _touches_before(former, residuals)
    test = _effect_test(job, estimation, former, residuals, touches_before)
    effect = test.measured(undrifted.residuals_mm, result.residuals_mm)
    change_mm = result.residuals_mm - undrifted.residuals_mm
    applied = _applied_table(job, estimation, former, residuals, touches_before, change_mm)
    change_um = f"{UM_PER_MM * before.rms_mm:.2f} to {UM_PER_MM * result.rms_mm:.2f} µm"
    if former.drift_mm.any():
        change_um += f" (before the table, {UM_PER_MM * undrifted.rms_mm:.2f} µm in the state to which it drifted)"
    reasons = (
        applied.reason,
        _shortfall(effect, change_um),
        _disagreement(effect.consistency.chi2_normalised, effect.max_chi2),
    )
    return Proof(
        accepted=effect.accepted and not applied.reason,
        before_um=UM_PER_MM * before.rms_mm,
        after_um=UM_PER_MM * result.rms_mm,
        predicted_um=UM_PER_MM * effect.consistency.predicted_mm,
        chi2_normalised=effect.consistency.chi2_normalised,
        change=effect.change,
        gain=effect.gain,
        limit=effect.limit,
        change_chi2_normalised=applied.chi2_normalised,
        reason="; ".join(filter(None, reasons)) or "effect shown, and as predicted",
    )


def _shortfall(effect: MeasuredEffect, change_um: str) -> str:
    """Return the reason why the measured effect does not prove the new table; empty if it does."""
    if effect.is_shown:
        return ""
    change, gain, limit = (f"{100.0 * share:.0f} %" for share in (effect.change, effect.gain, effect.limit))
    return (
        f"held-out positions do not show the effect of the table, {change_um}: they show {change} of the predicted "
        f"change and {gain} of the predicted gain, {limit} needed"
    )


def written_parameters(model: ErrorModel, correction: Correction, tool_offset_mm: Array) -> Array:
    """Return the values (p,) of the p parameters of `model`, in mm or rad, that a table with the corrections
    `correction` corrects: those whose deviations fit the corrections best. A rigid motion of the workspace, which a
    table may also contain, is left out."""
    grid = evaluation_grid(model.ranges_mm, _COARSE_GRID)
    points = grid + tool_offset_mm
    size_mm = float(np.ptp(points, axis=0).max())
    fields = np.concatenate(
        [deviation_basis(model, grid, tool_offset_mm), rigid_fields(points, points.mean(axis=0), size_mm)], axis=2
    )
    columns = fields.reshape(3 * len(grid), -1)
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    found = np.linalg.lstsq(columns / sizes, -correction(grid).reshape(-1), rcond=1e-9)[0] / sizes
    return np.asarray(found[: model.size])


def _field(estimate: Estimate, axis_positions: Array, tool_offset_mm: Array) -> Array:
    """Return the estimated deviations (n, 3) in mm of the machine without compensation."""
    return np.asarray(deviation_basis(estimate.model, axis_positions, tool_offset_mm) @ estimate.parameters)


def _place(ball: MeasuredBall) -> tuple[int, float, float, int]:
    """Return what identifies a ball in both measurements."""
    return ball.station, ball.azimuth_deg, ball.elevation_deg, ball.ball


def _correction_at(balls: Sequence[MeasuredBall], correction: Correction) -> Array:
    return correction(np.array([ball.found.centre_mm for ball in balls]))


def _certified(reference: ReferenceArtefact, balls: Sequence[MeasuredBall], when: str) -> list[MeasuredBall]:
    certified = certified_balls(balls, reference.artefact)
    if not certified:
        raise MeasurementFault(f"no ball of a held-out position was measured{when}")
    return certified


def _residual_covariance(
    reference: ReferenceArtefact,
    estimation: EstimationResult,
    observed: Observations,
    result: HeldOutResiduals,
    tool_offset_mm: Array,
) -> HeldOutCovariance:
    covariance = residual_covariance(estimation.estimate, observed.axis_positions, tool_offset_mm)
    return reference.covariance(observed, result, covariance, tool_offset_mm)


def _disagreement(chi2: float, limit: float) -> str:
    """Return the reason why held-out balls with the normalised χ² `chi2` are not as predicted; empty if they are."""
    return (
        ""
        if chi2 <= limit
        else f"held-out positions are not as predicted: normalised χ² {chi2:.2f}, allowed {limit:.2f}"
    )
