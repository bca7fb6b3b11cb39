"""Comparison of a machine with the prediction from the last accepted night, and diagnosis of a change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from agent.errors import MeasurementFault
from agent.files import translated
from agent.planning.job import Job
from agent.probing.measured_balls import Correction, MeasuredBall, no_correction, observations_of
from agent.results.gates.night_gate import night_text
from agent.results.night_changes import possible_text
from agent.results.observations import ReferenceArtefact, certified_balls
from agent.results.run_outcome import Decision, NightReport, SuspectedError
from agent.runs.change_since_reference import prior_tonight
from agent.runs.reference_state import ReferenceState
from twin.arrays import Array
from twin.artefact.held_out_check import held_out_residuals
from twin.identification import CarriedOverPrior, Estimate
from twin.identification.jump import SuspectedJump
from twin.machine.machine_population import Family
from twin.machine.volumetric import evaluation_grid
from twin.monitoring.night_fit import NightFit
from twin.monitoring.residual_with_active_table import ResidualWithTable, residual_covariance, uncompensated
from twin.monitoring.step_detection import Innovation, PossibleJump, innovation
from twin.monitoring.step_power import StepPower
from twin.units import UM_PER_MM

_LIKELIEST = 5


@dataclass(frozen=True, eq=False)
class Judgement:
    """Result of the comparison of a machine with the last accepted night.

    `report` is the result for people and for the journal; its `reason` is empty if everything is within limits. `found`
    contains the statistics on which `report` is based.
    """

    report: NightReport
    found: Innovation

    @property
    def within(self) -> bool:
        return not self.report.reason

    @property
    def power(self) -> StepPower:
        """Power of the measured balls to find a sudden change (step) of a machine error."""
        return StepPower(self.found.unknowns, self.found.information)


@dataclass(frozen=True, eq=False)
class Judge:
    """Comparison of the ball centres of one night with their prediction from the last accepted night. `nights` is the
    number of nights between the two."""

    job: Job
    reference: ReferenceState
    nights: float

    @cached_property
    def prior(self) -> CarriedOverPrior:
        """Prior for the identification of this night: the estimate of the last accepted night, with its uncertainty
        increased by the drift since then."""
        return prior_tonight(self.job, self.reference, self.nights)

    @cached_property
    def family(self) -> Family:
        return self.job.machine.with_model(self.prior.unknowns.model).family

    @cached_property
    def residual_with_table(self) -> ResidualWithTable:
        prior = self.prior
        grid = evaluation_grid(prior.unknowns.model.ranges_mm)
        return ResidualWithTable.build(prior.unknowns, prior.scales, grid, self.job.tool_offset_mm)

    @property
    def expected_change(self) -> Array:
        """Expected squares and products (p, p) of the change of the p model parameters since the active table was
        computed, in the units of `prior`: what earlier nights found, and the drift since the last of them."""
        prior, found = self.prior, self.reference.estimate
        own = prior.unknowns.blocks.parameters
        left = uncompensated(prior.unknowns, prior.mean, self.reference.table.written)[own]
        return np.multiply.outer(left, left) + prior.covariance[own, own] - found.z_covariance[own, own]

    @property
    def before_um(self) -> float:
        """Volumetric error (VE) in µm that was expected with the active compensation table at the end of the last
        accepted night.

        The error is computed after removal of the best-fitting rigid motion.
        """
        estimate = self.reference.estimate
        return self.residual_with_table.of(estimate.z, estimate.z_covariance, self.reference.table.written).aligned_um

    def expected_ve_um(self, estimate: Estimate, written: Array) -> float:
        """Return the volumetric error (VE) in µm that is expected from `estimate` if the active compensation table
        corrects the p parameters of the error model by the values `written` (p,).

        The error is computed after removal of the best-fitting rigid motion.
        """
        return self.residual_with_table.of(estimate.z, estimate.z_covariance, written).aligned_um

    def judge_balls(
        self,
        station: int,
        balls: Sequence[MeasuredBall],
        held_out: Sequence[MeasuredBall],
        correction: Correction,
        step_evidence: float,
    ) -> Judgement:
        """Compare the measured `balls` with their prediction from the last accepted night. All of them must have been
        measured with the active table.

        `held_out` contains the balls among `balls` that no estimate uses. `correction` is the correction that the
        active table adds to displayed axis positions. An error is reported as changed if the evidence for it is at
        least `step_evidence`. Raises MeasurementFault if too few balls were found for a comparison.
        """
        with translated(MeasurementFault):
            observations = observations_of(balls, self.job.tool_offset_mm, correction)
            found = innovation(self.family, observations, self.job.artefact, self.prior)
            found_um, predicted_um = self._held_out(held_out, correction)
        jumped = found.find_jumps(step_evidence)
        now_um = self.residual_with_table.of(
            found.posterior_mean, found.posterior_covariance, self.reference.table.written
        ).aligned_um
        possible = found.possible_jumps() if jumped else ()
        reason = self._reason(found, jumped, possible, now_um)
        report = NightReport(
            decision=Decision.OUT if reason else Decision.WITHIN,
            since=self.reference.run_id,
            nights=self.nights,
            station=station,
            positions=len(np.unique(observations.position)),
            reason=reason,
            ve_before_um=self.before_um,
            ve_now_um=now_um,
            held_out_um=found_um,
            held_out_predicted_um=predicted_um,
            chi2_normalised=found.chi2_normalised,
            jumped=tuple(_named(one) for one in jumped),
            alternatives=tuple(possible),
            likeliest=tuple(_named(one) for one in found.suspects()[:_LIKELIEST]),
        )
        return Judgement(report, found)

    def _held_out(self, held_out: Sequence[MeasuredBall], correction: Correction) -> tuple[float, float]:
        """Return the rms residual of the held-out balls at displayed axis positions, and the expected rms, both in
        µm."""
        offset, prior = self.job.tool_offset_mm, self.prior
        reference = ReferenceArtefact.of(self.job.artefact, prior.unknowns, prior.mean, prior.covariance)
        certified = certified_balls(held_out, reference.artefact)
        displayed, bare = (observations_of(certified, offset, shift) for shift in (no_correction, correction))
        result = held_out_residuals(displayed, displayed.axis_positions + offset, reference.artefact)
        left = uncompensated(prior.unknowns, prior.mean, self.reference.table.written)
        covariance = residual_covariance(
            prior.unknowns, prior.scales, left, prior.covariance, bare.axis_positions, offset
        )
        expected = reference.covariance(bare, result, covariance, offset)
        return UM_PER_MM * result.rms_mm, UM_PER_MM * expected.predicted_rms_mm

    def _reason(
        self,
        found: Innovation,
        jumped: Sequence[SuspectedJump],
        possible: Sequence[PossibleJump],
        now_um: float,
    ) -> str:
        """Return the reason why the machine is out of limits; empty if it is within limits."""
        limits = self.job.settings.nightly
        reasons = []
        if jumped:
            changed = f"the machine has changed at once: {', '.join(one.text for one in jumped)}"
            alone = f" (one error alone: {possible_text(possible)})" if len(possible) > 1 else ""
            reasons.append(f"{changed}{alone}")
        if found.chi2_normalised > limits.max_chi2:
            chi2 = found.chi2_normalised
            reasons.append(f"ball centres are not as predicted, χ² {chi2:.2f}, allowed {limits.max_chi2:.2f}")
        if now_um > limits.max_ve_growth * self.before_um:
            times = now_um / self.before_um
            reasons.append(f"VE is {times:.2f} times that of the last night, allowed {limits.max_ve_growth:.2f}")
        return "; ".join(reasons)


def with_fit(report: NightReport, fit: NightFit) -> NightReport:
    """Return `report` with the comparison of the fused balls with the nights before."""
    return replace(
        report,
        fit_probability=fit.probability,
        drift_factor=fit.factor,
        warning="" if fit.fits else night_text(fit),
        drift=fit.drift,
    )


def _named(suspect: SuspectedJump) -> SuspectedError:
    return SuspectedError(suspect.error, suspect.change, suspect.unit, suspect.evidence)
