"""What measured balls say: estimate, what it is worth, the table it makes; and whether held-out balls agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from agent.errors import MeasurementFault
from agent.files import translated
from agent.planning.job import Job
from agent.probing.position import MeasuredBall
from agent.results.facts import VolumetricSummary
from agent.results.observations import Correction, no_correction, observations_of
from agent.results.run_outcome import Proof
from agent.results.thermal_drift import identification_options, observations_with_drift
from agent.results.volumetric_summary import volumetric_summary
from agent.settings.schema import Order, TableSettings
from drivers.clock import utc_timestamp
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.held_out_check import HeldOutResiduals, held_out_residuals, held_out_test
from twin.artefact.observations import Observations
from twin.compensation.table import Anchor, CompensationTable, build_table, regular_nodes
from twin.identification import Estimate, Options, identify, identify_by_evidence, residual_covariance
from twin.machine.machine_description import MachineDescription
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class EstimationResult:
    """Estimate from `observations`, VE and VCE that it predicts, its compensation table."""

    observations: Observations
    estimate: Estimate
    volumetric: VolumetricSummary
    table: CompensationTable


def estimate_with_table(
    machine: MachineDescription,
    artefact: Artefact,
    tool: str,
    observations: Observations,
    options: Options,
    table: TableSettings,
    order: Order,
) -> EstimationResult:
    """Identify and build the table for `tool`. Raises TwinError."""
    offset = machine.tool(tool)
    estimate = estimate_machine(machine, artefact, observations, options, order)
    model = estimate.model
    nodes = regular_nodes(model.ranges_mm, table.step_mm)
    wanted = table.anchor_mm or (0.0, 0.0, 0.0)
    anchor = Anchor(np.array([np.clip(w, low, high) for w, (low, high) in zip(wanted, model.ranges_mm, strict=True)]))
    return EstimationResult(
        observations,
        estimate,
        volumetric_summary(estimate, offset),
        build_table(model, estimate.parameters, nodes, offset, anchor, observations.axis_positions),
    )


def estimate_machine(
    machine: MachineDescription, artefact: Artefact, observations: Observations, options: Options, order: Order
) -> Estimate:
    """Identify with the order asked for.

    An estimate that is carried over has its order; with the prior off no orders can be compared, and the evidence gives
    way to the machine file. Raises TwinError.
    """
    if options.carried_over is not None:
        machine = machine.with_model(options.carried_over.unknowns.model)
    elif isinstance(order, int):
        machine = machine.with_order(order)
    elif order == "evidence" and options.use_prior:
        return identify_by_evidence(lambda degree: machine.with_order(degree).family, observations, artefact, options)
    return identify(machine.model, observations, artefact, machine.family, options)


def order_text(estimate: Estimate) -> str:
    """Legendre order of an estimate for people, and what the measurements said of others."""
    used = sorted(set(estimate.model.orders.values()))
    text = " and ".join(str(order) for order in used)
    if not estimate.order_evidence:
        return text
    compared = ", ".join(f"{entry.order}: {entry.relative_log:.1f}" for entry in estimate.order_evidence)
    return f"{text}, by evidence (ln, against the likeliest: {compared})"


def scale_warnings(estimate: Estimate) -> tuple[str, ...]:
    """What somebody should know of scales that could go no farther."""
    return tuple(f"A scale ran into its bounds. {text[0].upper()}{text[1:]}." for text in estimate.scales_at_bounds)


def estimate_from_balls(job: Job, balls: Sequence[MeasuredBall], correction: Correction) -> EstimationResult:
    """Estimate from the balls of a run. `correction`: what the table active while measuring added. Raises TwinError."""
    settings = job.settings
    observations, order = observations_with_drift(job, balls, correction), settings.identification.order
    options = identification_options(settings.identification, settings.temperature, observations)
    return estimate_with_table(job.machine, job.artefact, settings.tool, observations, options, settings.table, order)


def prove(
    job: Job, estimation: EstimationResult, before: Sequence[MeasuredBall], after: Sequence[MeasuredBall]
) -> Proof:
    """Hold the balls measured with the table active against those before and against the prediction.

    Raises MeasurementFault where too few of them were found to say anything.
    """
    for balls, when in ((before, "before"), (after, "with the new table active")):
        if not balls:
            raise MeasurementFault(f"no ball of a held-out position was measured {when}")
    table = estimation.table
    with translated(MeasurementFault):
        observations_with_drift = observations_of(after, job.tool_offset_mm, table.at)
        result = _displayed_residuals(job, after)
        expected = held_out_test(
            observations_with_drift,
            result,
            job.artefact,
            residual_covariance(estimation.estimate, observations_with_drift.axis_positions, job.tool_offset_mm),
        )
        before_um, after_um = UM_PER_MM * _displayed_residuals(job, before).rms_mm, UM_PER_MM * result.rms_mm
    limits = job.settings.verification
    reason = _judgement(after_um / before_um, limits.max_remaining_fraction, expected.chi2_normalised, limits.max_chi2)
    return Proof(
        accepted=not reason,
        before_um=before_um,
        after_um=after_um,
        predicted_um=UM_PER_MM * expected.predicted_mm,
        chi2_normalised=expected.chi2_normalised,
        reason=reason or "better than before and as predicted",
    )


def provenance(job: Job, run_id: str) -> dict[str, str]:
    """What an estimate of this run rests on, for its file and the journal."""
    chosen = job.settings.identification
    return {
        "run_id": run_id,
        "time": utc_timestamp(),
        "software": f"volcal {version('volcal')}",
        "machine": job.settings.machine.name,
        "artefact": job.settings.artefact.name,
        "certificate": job.artefact.certificate,
        "prior": "family" if chosen.prior else "none",
        "weights": chosen.weights,
        "order": str(chosen.order),
        "table_tool": job.settings.tool,
    }


def _judgement(share: float, max_remaining_fraction: float, chi2: float, max_chi2: float) -> str:
    """Empty where both hold."""
    if share > max_remaining_fraction:
        return f"held-out positions keep {share:.2f} of their error, allowed {max_remaining_fraction:.2f}"
    if chi2 > max_chi2:
        return f"held-out positions are not as predicted: normalised χ² {chi2:.2f}, allowed {max_chi2:.2f}"
    return ""


def _displayed_residuals(job: Job, balls: Sequence[MeasuredBall]) -> HeldOutResiduals:
    """What the controller's own display makes of the artefact, as it was compensated while measuring."""
    displayed = observations_of(balls, job.tool_offset_mm, no_correction)
    points: Array = displayed.axis_positions + job.tool_offset_mm
    return held_out_residuals(displayed, points, job.artefact)
