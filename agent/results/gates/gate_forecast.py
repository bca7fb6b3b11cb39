"""Forecast of the gates (limits) that the estimate, the table and the proof of a run must pass, from settings and files
alone.

The covariance of an estimate depends on the positions of the balls, not on the measured values. The expected results
for a machine of the prior population therefore follow in closed form. Let E be the errors of the machine with the prior
covariance P0, and P the posterior covariance. The estimate, and with it the table, has the covariance P0 - P. The
forecast makes the gates by the same functions as a run, from expected values in place of measured ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial

import numpy as np
from scipy.special import chdtri

from agent.errors import ForecastRefused
from agent.figures.numbers import significant
from agent.files import translated
from agent.planning.job import Job
from agent.results.estimation import table_grid
from agent.results.gates.estimate_gates import change_gate, fit_gate, redundancy_gate
from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import (
    CERTIFICATE,
    CHANGE,
    COMMON_SCALE,
    GATE_RULES,
    NIGHT,
    PATTERN,
    PROBE,
    PROOF_FIT,
    STEP,
)
from agent.results.gates.table_gates import (
    correction_gate,
    extrapolation_gate,
    gain_gate,
    proof_gate,
    slope_gate,
    unmeasured_gate,
)
from agent.results.observations import ReferenceArtefact
from agent.results.predicted_accuracy import planned_estimate
from agent.results.table_replacement import ExpectedGain
from agent.settings.schema import COVERAGE_FACTOR
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.effect_test import expected_power
from twin.artefact.held_out_check import held_out_residuals
from twin.artefact.observations import Observations
from twin.compensation.table import MeasuredRegion, Nodes, linear_corrections
from twin.identification import Estimate, expected_rms, regional_forms, residual_covariance
from twin.identification.predicted import FieldSums, field_sums
from twin.machine.anchor import Anchor
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import evaluation_grid
from twin.units import UM_PER_MM

_COARSE = 9  # nodes per axis at which the size of the corrections is evaluated; their series are smooth
_LARGE = 2.0  # standard deviations of the largest correction: 19 of 20 machines stay below at this node


@dataclass(frozen=True)
class GateForecast:
    """Expected result of one gate of a run.

    `key` is the settings key of the limit. `expected` is the value expected for a machine of the prior population, in
    the unit that `text` states; it is None if it is not finite. `comparison` is the sign ≤ or ≥ between the value and
    the limit of a gate that is passed. `remedy` says what to do if the gate is expected to
    refuse the run (`passes` is False), and is empty otherwise.
    """

    gate: str
    key: str
    expected: float | None
    limit: float
    passes: bool
    text: str
    remedy: str
    comparison: str

    @classmethod
    def of(cls, gate: Gate) -> GateForecast:
        finite = gate.value if math.isfinite(gate.value) else None
        rule = GATE_RULES[gate.name]
        remedy = "" if gate.passed else rule.remedy
        return cls(gate.name, rule.key, finite, gate.limit, gate.passed, gate.text, remedy, rule.sign)

    @property
    def figures(self) -> str:
        """Expected value and limit as a text."""
        return f"{self.expected_text}, required {self.limit_text}"

    @property
    def expected_text(self) -> str:
        return "no bound" if self.expected is None else significant(self.expected)

    @property
    def limit_text(self) -> str:
        """Limit with the sign of its comparison."""
        return f"{self.comparison} {significant(self.limit)}"

    def as_json(self) -> dict[str, object]:
        """Return the forecast as the JSON object that docs/reference/json.md describes."""
        return asdict(self)


def forecast_gates(job: Job, store_limit_mm: float = math.inf) -> tuple[GateForecast, ...]:
    """Return the forecast of every gate of the first run of `job`, in the order of the run.

    `store_limit_mm` is the largest correction that the controller accepts, if it is known. Raises ConfigurationError if
    the positions cannot identify the machine.
    """
    with translated(ConfigurationError, key="procedure.position_set"):
        planned = job.procedure.plan(job.positions).observations
    design = _Design(job, planned, planned_estimate(job, planned))
    gates = (
        *_probe_gates(job),
        *design.estimate_gates(),
        *design.table_gates(store_limit_mm * UM_PER_MM),
        *design.replacement_gates(),
    )
    return tuple(GateForecast.of(gate) for gate in gates)


def require_forecast(forecasts: Sequence[GateForecast]) -> None:
    """Raise ForecastRefused, which names the key of every limit that is expected to refuse the run, if there is one."""
    refused = [forecast for forecast in forecasts if not forecast.passes]
    if refused:
        named = "; ".join(
            GATE_RULES[forecast.gate].sentence(forecast.expected_text, forecast.limit) for forecast in refused
        )
        raise ForecastRefused(
            f"a run with these settings is expected to be refused: {named}",
            hint="; ".join(f"{forecast.key}: {forecast.remedy}" for forecast in refused),
            key=", ".join(forecast.key for forecast in refused),
        )


def _probe_gates(job: Job) -> tuple[Gate, ...]:
    check, stated_um = job.settings.probe_check, 2.0 * job.settings.procedure.touch_sigma_um
    if not check.enabled:
        return ()
    text = "2σ in µm of touches of the probe, as procedure.touch_sigma_um states"
    return (Gate(PROBE, stated_um <= check.limit_um, stated_um, check.limit_um, text),)


@dataclass(frozen=True, eq=False)
class _Design:
    """Planned observations of `job` and the estimate expected from them, of which only the covariance is used."""

    job: Job
    planned: Observations
    estimate: Estimate

    @cached_property
    def known(self) -> Array:
        """Covariance (p, p) of the estimated parameters over the machines of the prior population."""
        prior, posterior = np.diag(self.estimate.prior_scale**2), self.estimate.covariance
        # without the prior an estimate is the machine plus its error; with it, it is the part that is known
        return prior - posterior if self.job.settings.identification.prior else prior + posterior

    def estimate_gates(self) -> tuple[Gate, ...]:
        limits = self.job.gate_limits
        return (
            fit_gate(1.0, limits),
            redundancy_gate(self.estimate.degrees_of_freedom, limits),
            self._certificate(limits.max_certificate_en),
            Gate(STEP, True, 1.0, limits.step_false_alarm, "probability bound of a machine that does not change"),
            Gate(PATTERN, True, 1.0, limits.pattern_false_alarm, "probability bound of balls that are not shifted"),
            self._common_scale(),
            self._change(),
            Gate(NIGHT, limits.night_false_alarm <= 0.5, 0.5, limits.night_false_alarm, "probability of a night"),
        )

    @cached_property
    def travel_errors_um(self) -> tuple[float, float]:
        """Rms volumetric errors in µm over the whole travel, after removal of the best-fitting rigid motion, that the
        table is expected to correct and to leave."""
        return self._errors_um(self._sums.forms[1])

    @cached_property
    def _grid(self) -> Array:
        return evaluation_grid(self.estimate.model.ranges_mm)

    @cached_property
    def _sums(self) -> FieldSums:
        return field_sums(self.estimate, self._grid, self.job.tool_offset_mm)

    def _errors_um(self, form: Array) -> tuple[float, float]:
        """Return the rms volumetric errors in µm that the table is expected to correct and to leave, for a quadratic
        form (p + q, p + q) of the error field with p parameters and q misfit coefficients."""
        size = self.estimate.model.size
        corrected = math.sqrt(max(float(np.vdot(form[:size, :size], self.known)), 0.0))
        return UM_PER_MM * corrected, UM_PER_MM * expected_rms(self.estimate, form)

    def _certificate(self, limit: float) -> Gate:
        """Return the gate for the largest contradiction t of n balls with a right certificate: t² has a χ² distribution
        with three degrees of freedom, and the median of the largest is where its distribution function is 2^(-1/n)."""
        balls = sum(check.certified for check in self.estimate.certificate_check)
        sigmas = math.sqrt(float(chdtri(3.0, -math.expm1(-math.log(2.0) / balls)))) if balls else 0.0
        value = sigmas / COVERAGE_FACTOR
        text = f"largest contradiction of {balls} right balls with their certificate, |E_n| with k = 2"
        return Gate(CERTIFICATE, value <= limit, value, limit, text)

    def _common_scale(self) -> Gate:
        text = "probability bound of a machine and an artefact as stated"
        return Gate(COMMON_SCALE, True, 1.0, self.job.gate_limits.common_scale_false_alarm, text)

    def _change(self) -> Gate:
        gate = change_gate(1.0, 1.0, self.job.gate_limits)
        text = "change of an unchanged machine since the last accepted night, in units of its uncertainty"
        return Gate(CHANGE, gate.passed, gate.value, gate.limit, text)

    def table_gates(self, store_um: float) -> tuple[Gate, ...]:
        model, limits, offset = self.estimate.model, self.job.gate_limits, self.job.tool_offset_mm
        nodes, anchor = table_grid(model, self.job.settings.table)
        region = MeasuredRegion.around(self.planned.axis_positions)
        outside = ~region.contains(np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3))
        form = regional_forms(self.estimate, self._grid, region.contains(self._grid), offset, self._sums)[1]
        largest, steepest = self._largest_corrections(nodes, anchor)
        return (
            correction_gate(UM_PER_MM * largest, store_um, limits),
            slope_gate(UM_PER_MM * steepest, limits),
            extrapolation_gate(float(outside.mean()), limits),
            unmeasured_gate(*((0.0, 0.0) if form is None else self._errors_um(form)), limits),
        )

    def _largest_corrections(self, nodes: Nodes, anchor: Anchor) -> tuple[float, float]:
        """Return the largest expected correction in mm and the steepest expected slope between neighbouring nodes."""
        corrections = partial(
            linear_corrections, self.estimate.model, nodes=nodes, tool_offset=self.job.tool_offset_mm, anchor=anchor
        )
        lines = [line[np.unique(np.linspace(0, len(line) - 1, _COARSE).astype(int))] for line in nodes]
        points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        slopes = []
        for axis, line in enumerate(nodes):
            spacing, lower = float(line[1] - line[0]), points.copy()
            lower[:, axis] = np.minimum(lower[:, axis], line[-2])
            upper = lower + spacing * np.eye(3)[axis]
            slopes.append(self._largest((corrections(upper) - corrections(lower)) / spacing))
        return self._largest(corrections(points)), max(slopes)

    def _largest(self, fields: Array) -> float:
        """Return twice the largest standard deviation of linear functions (n, 3, p) of the estimated parameters."""
        rows = fields.reshape(-1, fields.shape[-1])
        return _LARGE * math.sqrt(max(float(np.einsum("rp,rp->r", rows @ self.known, rows).max()), 0.0))

    def replacement_gates(self) -> tuple[Gate, ...]:
        """Return the gates of the rule by which a new table replaces the active compensation, which is none."""
        limits = self.job.settings.verification
        corrected_um, left_um = self.travel_errors_um
        gain = ExpectedGain(math.hypot(corrected_um, left_um), left_um)
        return (
            gain_gate(gain, limits.min_gain),
            proof_gate(self._expected_power()),
            Gate(PROOF_FIT, limits.max_chi2 >= 1.0, 1.0, limits.max_chi2, "normalised χ² of held-out balls"),
        )

    def _expected_power(self) -> float:
        """Return the probability that the run writes the first table and that its proof accepts it, over the machines
        of the prior population whose tables work."""
        estimate, offset = self.estimate, self.job.tool_offset_mm
        reference = ReferenceArtefact.of(self.job.artefact, estimate.unknowns, estimate.z, estimate.z_covariance)
        stated = self.job.settings.verification
        key = "positions" if stated.positions_deg is None else "positions_deg"
        with translated(ConfigurationError, key=f"verification.{key}"):
            seen = self.job.procedure.plan(self.job.held_out).observations
            residuals = held_out_residuals(seen, seen.axis_positions + offset, reference.artefact)
        left = residual_covariance(estimate, seen.axis_positions, offset)
        covariance = reference.covariance(seen, residuals, left, offset)
        fields = covariance.basis.T @ deviation_basis(estimate.model, seen.axis_positions, offset).reshape(
            len(covariance.basis), -1
        )
        return expected_power(fields @ self.known @ fields.T, covariance, stated.max_chi2)
