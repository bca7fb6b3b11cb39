"""Estimation of the machine's errors from measured balls.

The module computes the estimate, the predicted accuracy and the compensation table.

Computation of the volumetric error inside and outside the measured region from an estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version

import numpy as np

from agent.planning.job import Job
from agent.probing.measured_balls import Correction, MeasuredBall, observations_of, position_numbers
from agent.results.artefact_calibration import calibration_record
from agent.results.facts import Quantity, VolumetricSummary
from agent.results.observations import ReferenceArtefact, positions_named
from agent.results.table_image import table_as_applied
from agent.results.travel_parts import TravelPart, TravelParts
from agent.settings.schema import IdentificationSettings, Order, TableSettings
from agent.settings.temperature import TemperatureSettings
from agent.thermal.machine_drift import RunDrift, run_drift, thermal_options
from agent.thermal.thermometer import ThermometerFacts, ThermometerStatement
from drivers.clock import utc_timestamp
from drivers.roles import StoreLimits
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.compensation.table import CompensationTable, MeasuredRegion, Nodes, build_table, regular_nodes
from twin.formats.estimate_file import (
    ball_shift_documents,
    common_scale_document,
    format_estimate,
    pattern_document,
    step_document,
)
from twin.formats.estimate_sections import VolumetricSection
from twin.formats.instrument_section import instrument_documents
from twin.identification import Estimate, Options, expected_rms, identify, identify_by_evidence, regional_forms
from twin.identification.checks.measured_shape import check_shape
from twin.identification.instruments.consistency import identify_with_instruments
from twin.identification.instruments.readings import InstrumentReadings
from twin.identification.predicted import FieldSums, expected_vce, field_forms, field_sums
from twin.machine.anchor import Anchor
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.machine_description import MachineDescription
from twin.machine.volumetric import QuadraticForm, evaluation_grid, volumetric_error
from twin.uncertainty.thermometer_effect import thermometer_effect
from twin.uncertainty.volumetric_limits import limits_of_form
from twin.units import UM_PER_MM

_NEGLIGIBLE = 0.1


@dataclass(frozen=True)
class EstimationResult:
    """Estimate of the machine's errors from `observations`, and the compensation table made from the estimate.

    `volumetric` contains the estimated volumetric error (VE) of the machine without compensation and the predicted
    volumetric compensated error (VCE), the volumetric error that remains with the table active. `travel` contains both
    inside and outside the measured region. `thermometer` is the effect of the artefact's thermometer on the prediction.
    `lost_um` is the part of the VCE in µm that the controller causes because it does not apply the whole table.
    """

    observations: Observations
    estimate: Estimate
    volumetric: VolumetricSummary
    travel: TravelParts
    table: CompensationTable
    thermometer: ThermometerFacts
    lost_um: float = 0.0

    @property
    def unknown_um(self) -> float:
        """Volumetric error in µm, after removal of the best-fitting rigid motion, that is left if all estimated errors
        are corrected."""
        return math.sqrt(max(self.volumetric.after_aligned.value_um**2 - self.lost_um**2, 0.0))

    def applied_by(self, store: StoreLimits, tool_offset_mm: Array) -> EstimationResult:
        """Return the same result with the VCE that is left if a controller with the limits `store` applies the table
        of this result in its own form. Losses that change the VCE by less than 0.5 % are left out."""
        table = table_as_applied(self.table, store)
        estimate, after = self.estimate, self.volumetric.after_aligned
        grid = evaluation_grid(estimate.model.ranges_mm)
        left = deviation_basis(estimate.model, grid, tool_offset_mm) @ estimate.parameters + table.at(grid)
        lost_um = volumetric_error(grid + tool_offset_mm, left).aligned_um
        if lost_um < _NEGLIGIBLE * after.value_um:
            return self
        low, high = (math.hypot(limit, lost_um) for limit in after.limits_um or (after.value_um, after.value_um))
        value_um = math.hypot(after.value_um, lost_um)
        doubt = after.standard_uncertainty_um
        applied = Quantity(
            value_um,
            None if doubt is None else doubt * after.value_um / value_um,
            None if after.limits_um is None else (low, high),
        )
        return replace(self, volumetric=replace(self.volumetric, after_aligned=applied), lost_um=lost_um)

    def reference(self, artefact: Artefact) -> ReferenceArtefact:
        """Return the artefact with whose balls the table is proved, for the `artefact` of the artefact file. Its sag is
        the estimated one."""
        estimate = self.estimate
        artefact = replace(artefact, sag_mm=artefact.sag_mm + estimate.found_sag_mm)
        return ReferenceArtefact.of(artefact, estimate.unknowns, estimate.z, estimate.z_covariance)

    def with_numbers(self, numbers: Sequence[int]) -> EstimationResult:
        """Return the same result, in which a change of the machine in the run names each position by its number in
        `numbers`, not by its index."""
        step = self.estimate.step
        return self if step is None else replace(self, estimate=replace(self.estimate, step=step.numbered(numbers)))

    def as_json(self) -> dict[str, object]:
        """Return the JSON object of the estimation, which is part of those of a run and of an identification from
        files (docs/reference/json.md)."""
        estimate, before, after = self.estimate, self.volumetric.before_aligned, self.volumetric.after_aligned
        return {
            "rank": estimate.rank,
            "parameters": estimate.model.size,
            "estimated_ve_um": before.value_um,
            "estimated_ve_limits_um": before.limits_um and list(before.limits_um),
            "predicted_vce_um": after.value_um,
            "predicted_vce_limits_um": after.limits_um and list(after.limits_um),
            "thermometer": asdict(self.thermometer),
            "travel": self.travel.as_record(),
            "artefact_calibration": calibration_record(estimate.artefact_calibration),
            "chi2_normalised": estimate.chi2_normalised,
            "step_in_run": step_document(estimate.step),
            "shift_pattern": pattern_document(estimate.pattern),
            "ball_shifts": ball_shift_documents(estimate.shifts),
            "common_scale": common_scale_document(estimate.common_scale),
            "instruments": instrument_documents(estimate.instruments),
            "rejected": [list(row) for row in estimate.rejected],
        }


NO_ESTIMATION: dict[str, object] = {
    **dict.fromkeys(("rank", "parameters", "estimated_ve_um", "estimated_ve_limits_um")),
    **dict.fromkeys(("predicted_vce_um", "predicted_vce_limits_um", "thermometer", "travel")),
    **dict.fromkeys(("artefact_calibration", "chi2_normalised", "step_in_run", "shift_pattern")),
    "ball_shifts": [],
    "common_scale": None,
    "instruments": [],
    "rejected": [],
}
"""JSON object of an estimation that was not made."""


def estimate_with_table(
    machine: MachineDescription,
    artefact: Artefact,
    tool: str,
    observations: Observations,
    options: Options,
    thermometer: ThermometerStatement,
    table: TableSettings,
    order: Order,
) -> EstimationResult:
    """Identify the machine's errors and build the compensation table for `tool`. `thermometer` states the origin of
    the artefact's temperature and of its uncertainty. Raises TwinError if this is not possible."""
    offset = machine.tool(tool)
    estimate = estimate_machine(machine, artefact, observations, options, order)
    model = estimate.model
    nodes, anchor = table_grid(model, table)
    sums = field_sums(estimate, evaluation_grid(model.ranges_mm), offset)
    forms = sums.forms
    built = build_table(model, estimate.parameters, nodes, offset, anchor, observations.axis_positions)
    return EstimationResult(
        observations,
        estimate,
        volumetric_summary(estimate, offset, forms),
        travel_parts(estimate, offset, observations.axis_positions, sums),
        replace(built, machine=machine.name, artefact=artefact.name),
        ThermometerFacts.of(thermometer_effect(estimate, forms), thermometer),
    )


def table_grid(model: ErrorModel, table: TableSettings) -> tuple[Nodes, Anchor]:
    """Return the nodes and the anchor of the compensation table of `model` with the settings `table`. The anchor is
    moved into the range of the axes."""
    requested = table.anchor_mm or (0.0, 0.0, 0.0)
    clipped = [np.clip(value, low, high) for value, (low, high) in zip(requested, model.ranges_mm, strict=True)]
    return regular_nodes(model.ranges_mm, table.step_mm), Anchor(np.array(clipped))


def estimate_machine(
    machine: MachineDescription, artefact: Artefact, observations: Observations, options: Options, order: Order
) -> Estimate:
    """Identify the machine's errors, modelled by Legendre series of the requested `order`. Raises TwinError if this is
    not possible.

    If `order` is "evidence", the order with the largest Bayesian evidence is used. The evidence of several orders can
    be compared only if the prior population is used; otherwise, the order of the machine file is used. If an earlier
    estimate is carried over, the order of that estimate is used in any case. Instruments in `options` are tested first,
    and joined if they do not contradict.
    """
    check_shape(observations, artefact)

    def identify_with(instruments: tuple[InstrumentReadings, ...]) -> Estimate:
        return _estimate(machine, artefact, observations, replace(options, instruments=instruments), order)

    if not options.instruments:
        return identify_with(())
    return identify_with_instruments(identify_with, options.instruments, keep_contradicting=options.join_contradicting)


def _estimate(
    machine: MachineDescription, artefact: Artefact, observations: Observations, options: Options, order: Order
) -> Estimate:
    if options.carried_over is not None:
        machine = machine.with_model(options.carried_over.unknowns.model)
    elif isinstance(order, int):
        machine = machine.with_order(order)
    elif order == "evidence" and options.use_prior:
        return identify_by_evidence(lambda degree: machine.with_order(degree).family, observations, artefact, options)
    return identify(machine.model, observations, artefact, machine.family, options)


def order_text(estimate: Estimate) -> str:
    """Return a text that states the Legendre order of `estimate`. If several orders were compared, the text also states
    their Bayesian evidence."""
    used = sorted(set(estimate.model.orders.values()))
    text = " and ".join(str(order) for order in used)
    if not estimate.order_evidence:
        return text
    compared = ", ".join(f"{entry.order}: {entry.relative_log:.1f}" for entry in estimate.order_evidence)
    return f"{text}, by evidence (ln, against the likeliest: {compared})"


def scale_warnings(estimate: Estimate) -> tuple[str, ...]:
    """Return one warning for each scale that has reached a bound of its permitted range. A scale is an estimated factor
    by which an assumed standard deviation is multiplied."""
    return tuple(f"A scale ran into its bounds. {text[0].upper()}{text[1:]}." for text in estimate.scales_at_bounds)


def instrument_warnings(estimate: Estimate) -> tuple[str, ...]:
    """Return one warning for each other instrument that contradicts the ball centres or the other instruments."""
    return tuple(
        f"{check.name} ({check.kind}) contradicts the ball centres and the other instruments: {check.largest.text} (χ² "
        f"{check.chi2:.0f} with {check.degrees_of_freedom} degrees of freedom). "
        f"{'It was joined all the same.' if check.joined else 'It was not used.'}"
        for check in estimate.instruments
        if check.contradicts
    )


def estimate_from_balls(job: Job, balls: Sequence[MeasuredBall], correction: Correction) -> EstimationResult:
    """Return the estimate of the machine's errors from the balls measured in a run, and the compensation table made
    from the estimate. Raises TwinError if the balls do not allow an estimate.

    `correction` is the correction that the active table added during the measurement.
    """
    drift = run_drift(job.settings.temperature, [ball.conditions for ball in balls])
    observations = observations_of(balls, job.tool_offset_mm, correction, drift)
    options = identification_options(job.settings.identification, job.settings.temperature, drift)
    return estimate_in_run(job, balls, observations, options)


def identification_options(
    identification: IdentificationSettings, temperature: TemperatureSettings, drift: RunDrift | None
) -> Options:
    """Return the options for an identification of the machine's errors without a prior from earlier nights. `drift` is
    the drift of the machine during the measurement, or None if it is not estimated."""
    return replace(
        thermal_options(temperature, drift),
        formulation=identification.formulation,
        use_prior=identification.prior,
        weights=identification.weights,
    )


def estimate_in_run(
    job: Job, balls: Sequence[MeasuredBall], observations: Observations, options: Options
) -> EstimationResult:
    """Return the estimate of `estimate_for_job` from the `observations` of the `balls` of a run. Positions, also those
    that an error names, have their numbers in the run."""
    with positions_named(balls):
        return estimate_for_job(job, observations, options).with_numbers(position_numbers(balls))


def estimate_for_job(job: Job, observations: Observations, options: Options) -> EstimationResult:
    """Return the estimate of the machine's errors from `observations` and the compensation table made from it, with the
    settings of `job`. Raises TwinError if this is not possible."""
    settings = job.settings
    return estimate_with_table(
        job.machine,
        job.artefact,
        settings.tool,
        observations,
        options,
        ThermometerStatement.of(
            settings.temperature.standard_uncertainty_k, settings.temperature.declared_artefact_c is None
        ),
        settings.table,
        settings.identification.order,
    )


def estimate_text(estimation: EstimationResult, origin: Mapping[str, str]) -> str:
    """Return the text of the estimate file of `estimation`. `origin` maps names such as `software` to texts on the
    origin of the estimate."""
    before, after = estimation.volumetric.before_aligned, estimation.volumetric.after_aligned
    stated = VolumetricSection(
        estimated_ve_um=before.value_um,
        estimated_ve_limits_um=before.limits_um,
        predicted_vce_um=after.value_um,
        predicted_vce_limits_um=after.limits_um,
    )
    return format_estimate(estimation.estimate, origin, stated)


def provenance(job: Job, run_id: str) -> dict[str, str]:
    """Return the origin of an estimate for its file and for the journal: run, time, software, machine, artefact and
    options."""
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


def volumetric_summary(
    estimate: Estimate, tool_offset: Array, forms: tuple[Array, Array] | None = None
) -> VolumetricSummary:
    """Return the estimated volumetric error (VE) of the machine without compensation and the volumetric compensated
    error (VCE) expected with compensation, each with its 95 % limits.

    Both are computed over the standard grid of the workspace, in µm, after removal of the best-fitting rigid motion.
    `forms` are the two quadratic forms of the error field over this grid that `field_forms` returns; they are computed
    if they are None.
    """
    grid = evaluation_grid(estimate.model.ranges_mm)
    form = QuadraticForm.build(estimate.model, grid, tool_offset)
    if forms is None:
        forms = field_forms(estimate, grid, tool_offset)
    limits = limits_of_form(estimate, forms[1])
    table_ve_mm = form.value(estimate.parameters).aligned_mm
    return VolumetricSummary(
        before_aligned=Quantity(limits.expected_ve_um, _uncertainty_um(table_ve_mm, form, estimate), limits.ve_um),
        after_aligned=_expected(expected_vce(estimate, forms).aligned_mm, form.aligned, estimate, limits.vce_um),
        table_ve_um=UM_PER_MM * table_ve_mm,
    )


def _uncertainty_um(value_mm: float, form: QuadraticForm, estimate: Estimate) -> float:
    """Return the standard uncertainty u in µm of the VE `value_mm` of the estimated parameters.

    If the parameters are E, their covariance is P and the matrix of `form` is Q, the VE is v = sqrt(E'QE). To first
    order, u² = E'Q P Q E / v².
    """
    gradient = form.aligned @ estimate.parameters / max(value_mm, 1e-12)
    variance = float(gradient @ estimate.covariance @ gradient)
    return UM_PER_MM * float(np.sqrt(max(variance, 0.0)))


def _expected(value_mm: float, form: Array, estimate: Estimate, limits_um: tuple[float, float]) -> Quantity:
    """Return the expected VCE and, as its uncertainty, the standard deviation of the VCE of one machine, in µm.

    If the parameter errors e are normally distributed with covariance P, and the matrix `form` is Q, then VCE² = e'Qe
    has the variance 2 trace(QPQP).
    """
    product = form @ estimate.covariance
    variance = 2.0 * float(np.einsum("ij,ji->", product, product))
    uncertainty_mm = float(np.sqrt(max(variance, 0.0))) / (2.0 * max(value_mm, 1e-12))
    return Quantity(UM_PER_MM * value_mm, UM_PER_MM * uncertainty_mm, limits_um)


def travel_parts(estimate: Estimate, tool_offset: Array, measured: Array, sums: FieldSums | None = None) -> TravelParts:
    """Return the volumetric error inside and outside the region around the measured axis positions `measured` (n, 3) in
    mm, for a tool offset (3,) in mm.

    The region is the one outside which nodes of the compensation table count as extrapolated: the convex hull of the
    measured positions with a margin of half a ball pitch. The grid is that of the volumetric error. `sums` are the sums
    of the error field over this grid; they are computed if they are None.
    """
    grid = evaluation_grid(estimate.model.ranges_mm)
    inside = MeasuredRegion.around(measured).contains(grid)
    forms = regional_forms(estimate, grid, inside, tool_offset, sums)
    share = float(inside.mean())
    first, second = (
        None if form is None else _travel_part(estimate, form, part)
        for form, part in zip(forms, (share, 1.0 - share), strict=True)
    )
    return TravelParts(first, second)


def _travel_part(estimate: Estimate, form: Array, share: float) -> TravelPart:
    """Return the volumetric error in the part of the travel with the quadratic form `form` (p + q, p + q) in mm², as
    `volumetric_summary` computes it for the whole travel."""
    size, limits = estimate.model.size, limits_of_form(estimate, form)
    corrected = float(estimate.parameters @ form[:size, :size] @ estimate.parameters)
    return TravelPart(
        share=share,
        estimated_ve_um=limits.expected_ve_um,
        estimated_ve_limits_um=limits.ve_um,
        table_ve_um=UM_PER_MM * float(np.sqrt(max(corrected, 0.0))),
        predicted_vce_um=UM_PER_MM * expected_rms(estimate, form),
        predicted_vce_limits_um=limits.vce_um,
    )
