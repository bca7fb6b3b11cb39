"""Expected volumetric compensated error (VCE) in closed form, divided into contributions of influences.

Influences are the causes of error, such as touch noise.

The estimate is a linear function of all errors of a calibration procedure (`twin.uncertainty.linear_estimator`). The
field that remains after compensation is therefore also linear in these errors. The mean square of this field, expected
over machines, certificates and touches, is the trace of the matrix product Q M. Q is the quadratic form of the field,
and M contains the second moments of its parameters. All influences are independent and have mean zero, except the
deflection of the true machines, which is the same for all machines and contributes its own mean square. The squares of
the contributions therefore add up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem, build_problem
from twin.machine.deviation_basis import deviation_basis_of_tools
from twin.machine.error_model import ErrorModel
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms
from twin.uncertainty.linear_estimator import LinearEstimator
from twin.uncertainty.quadratic_distribution import QuadraticDistribution
from twin.uncertainty.residual_field_form import FieldForm, clamped_deflection
from twin.uncertainty.truth_assumptions import TruthAssumptions
from twin.uncertainty.volumetric_distribution import VolumetricDistribution

TOUCH_NOISE, CERTIFICATE, CTE, TEMPERATURE = "touch noise", "certificate", "CTE", "temperature"
DRIFT, MOUNT, MISFIT, UNSEEN = "drift", "mount", "misfit", "unseen"
INFLUENCES = (TOUCH_NOISE, CERTIFICATE, CTE, TEMPERATURE, DRIFT, MOUNT, MISFIT, UNSEEN)
"""Influences in the order in which the table lists them.

`mount` is the pose of the artefact. It contributes nothing, because the poses are free unknowns. `misfit` covers the
errors of the true machines that the model cannot represent, including the deflection, and the bias that these errors
cause in the parameters. `unseen` covers the model's own parameters, to the extent that the position set does not
determine them or the prior shrinks them towards zero. The effects of the assumptions (`twin.uncertainty.
measurement_effects`) follow them under their own names.
"""


@dataclass(frozen=True, eq=False)
class ErrorBudget:
    """Contribution of each influence, such as touch noise, to the expected volumetric compensated error (VCE).

    The residual field has u parameters: those of the joint model of `field`, which combines the identified model and
    the model of the true machines. `moments` contains, for each influence, the second moments, shape (u, u), that the
    influence causes in these parameters. `bias`, shape (u,), contains the errors that the deflection causes in the
    parameters. The deflection is the same for all true machines. `machines`, shape (u, t), contains the errors that
    remain in the parameters per standard deviation of each of the t true parameters of a machine.
    """

    field: FieldForm
    moments: Mapping[str, Array]
    bias: Array
    machines: Array

    @cached_property
    def contributions(self) -> Mapping[str, VolumetricRms]:
        """Contribution of each influence to the expected volumetric compensated error (VCE), keyed by influence.

        An influence, such as touch noise, causes a part of the expected mean square; its contribution is the root of
        this part.
        """
        squares = {name: self.field.mean_square(moments) for name, moments in self.moments.items()}
        fixed = self.field.fixed_square(self.bias)
        # The deflection is the same on all machines. All other influences have mean zero, so no mixed term arises
        # between them and its field, and the two mean squares add up.
        squares[MISFIT] = (squares[MISFIT][0] + fixed[0], squares[MISFIT][1] + fixed[1])
        return {name: _root(raw, aligned) for name, (raw, aligned) in squares.items()}

    @cached_property
    def expected(self) -> VolumetricRms:
        """Expected volumetric compensated error (VCE): the root of the mean square expected over machines."""
        parts = self.contributions.values()
        return _root(sum(part.raw_mm**2 for part in parts), sum(part.aligned_mm**2 for part in parts))

    @cached_property
    def uncompensated(self) -> VolumetricRms:
        """Expected volumetric error (VE): the root of the mean square expected over machines without compensation."""
        return self.field.uncompensated()

    @cached_property
    def total(self) -> Array:
        """Second moments, shape (u, u), that all influences together cause in the u parameters of the residual field.

        The deflection, which is the same for all true machines, is not included.
        """
        return np.asarray(np.sum(list(self.moments.values()), axis=0))

    @property
    def distribution(self) -> VolumetricDistribution:
        """Distribution of the volumetric compensated error (VCE) over machines with Gaussian parameters.

        The parameters have the variances that they have in the family of the true machines.
        """
        form = self.field.form
        return VolumetricDistribution(
            QuadraticDistribution.of(form.raw, form.raw_linear, form.raw_constant, self.bias, self.total),
            QuadraticDistribution.of(form.aligned, form.aligned_linear, form.aligned_constant, self.bias, self.total),
        )

    def draw_residuals(self, machines: ArrayLike, rng: np.random.Generator) -> Array:
        """Return the parameters, shape (m, u), of the residual fields of m machines.

        `machines`, shape (m, t), contains the true parameters of each machine in units of their standard deviations, so
        that the same machines can be measured by several procedures. Touches, certificate and the other influences are
        drawn from normal distributions with `rng`.
        """
        drawn = np.asarray(machines, dtype=np.float64)
        # what the machines themselves do not cause, as a factor F with F Fᵀ = M
        others = np.sum([part for name, part in self.moments.items() if name not in (MISFIT, UNSEEN)], axis=0)
        sizes, directions = np.linalg.eigh(others)
        factor = directions * np.sqrt(np.maximum(sizes, 0.0))
        return np.asarray(
            self.bias + drawn @ self.machines.T + rng.standard_normal((len(drawn), len(sizes))) @ factor.T
        )

    def parameter_uncertainty(self) -> Array:
        """Return the rms errors, shape (p,), of the p identified parameters (true minus identified) in mm or rad."""
        # E[e²] = variance + bias², for each parameter
        squares = np.maximum(np.diagonal(self.total) + self.bias**2, 0.0)
        return np.asarray(np.sqrt(squares[self.field.model_indices]))

    def field_uncertainty(self, axis_positions: ArrayLike, aligned: bool = False) -> Array:
        """Return the expected rms, shape (n, 3), of each component of the residual field, in mm.

        The residual field is the true machine minus the compensation model, taken at n `axis_positions`, shape (n, 3).
        If `aligned`, the best-fitting rigid motion over the grid of `field` is removed first, since an artefact in an
        unknown pose cannot determine this motion.
        """
        basis, deflection = self.field.columns_at(axis_positions, aligned)
        # The row b of the basis gives the field component bᵀe + f: E[(bᵀe + f)²] = bᵀM b + (f + bᵀbias)².
        squares = np.einsum("nip,nip->ni", basis @ self.total, basis) + (deflection + basis @ self.bias) ** 2
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def error_budget(
    model: ErrorModel,
    family: Family,
    artefact: Artefact,
    observations: Observations,
    options: Options,
    assumptions: TruthAssumptions,
    grid: ArrayLike,
    tool_offset: ArrayLike,
) -> ErrorBudget:
    """Return the error budget of a calibration procedure that identifies `model` from planned `observations`.

    The true machines follow `assumptions`; `family` is the prior of the identification. The error after compensation is
    evaluated for a tool offset, shape (3,), on a `grid` of axis positions, shape (n, 3), in mm. The scales are 1 and no
    ball is rejected, regardless of `options`. To evaluate many sets of artefact positions, build the `FieldForm`
    (quadratic form of the residual field) once and use `error_budget_of_form`.
    """
    return error_budget_of_form(
        FieldForm.build(model, assumptions, grid, tool_offset), family, artefact, observations, options
    )


def error_budget_of_form(
    field: FieldForm, family: Family, artefact: Artefact, observations: Observations, options: Options
) -> ErrorBudget:
    """Return the error budget of a calibration procedure for an existing quadratic form `field`.

    `field` is the quadratic form of the residual field. `family` is the prior of the identification. Raises DataError
    if the error models of `family` and `field` differ.
    """
    if family.model != field.model:
        raise DataError("the family belongs to another model", hint="use the family of the same machine file")
    assumptions = field.assumptions
    # The observations take the true temperature; the thermometer error enters as an influence of its own.
    warm = np.full(observations.size, assumptions.artefact_temperature_c)
    problem = build_problem(family, replace(observations, temperature_c=warm), artefact, options)
    influences = _influences(problem, field, artefact)
    estimator = LinearEstimator.of(problem, options, np.concatenate(list(influences.values()), axis=2))
    ends = np.cumsum([part.shape[2] for part in influences.values()])
    answers = dict(zip(influences, np.split(estimator.influences, ends[:-1], axis=1), strict=True))
    # Response K f of the estimate to a field f of one standard deviation; the residual error is -K f, and its second
    # moment K f fᵀ Kᵀ. For a true machine parameter the residual is the parameter itself minus the response.
    effects = [effect.name for effect in assumptions.effects]
    moments = {name: _moments(field, -answers[name]) for name in (CTE, TEMPERATURE, DRIFT, *effects)}
    machines = _machine_residuals(field, answers["machines"])
    none = np.zeros((field.size, field.size))
    certificate = _moments(field, estimator.certificate) if assumptions.certificate else none
    moments |= {
        TOUCH_NOISE: _embed(field, estimator.noise) if assumptions.touch_noise else none,
        CERTIFICATE: certificate,
        MOUNT: none,
        # The columns of `machines` are independent parameters of the true machine, so their moments may be summed in
        # two groups: those that the model lacks, and its own.
        MISFIT: machines[:, field.unmodelled] @ machines[:, field.unmodelled].T,
        UNSEEN: machines[:, ~field.unmodelled] @ machines[:, ~field.unmodelled].T,
    }
    bias = np.zeros(field.size)
    bias[field.model_indices] = -answers["deflection"].sum(axis=1)
    return ErrorBudget(field, {name: moments[name] for name in (*INFLUENCES, *effects)}, bias, machines)


def _influences(problem: IdentificationProblem, field: FieldForm, artefact: Artefact) -> dict[str, Array]:
    """Return, for each influence, the fields (n, 3, x) in mm that it causes at the n rows.

    Each column is the field of one standard deviation of an error; the deflection is a single column with its actual
    value.
    """
    seen, assumptions = problem.observations, field.assumptions
    stretched = problem.layout.unpad(problem.layout.pad(artefact.balls[seen.ball]) @ _transposed_rotations(problem))[
        :, :, None
    ]
    warmer_k = assumptions.artefact_temperature_c - artefact.reference_temperature_c
    # An error of the CTE acts only through the departure from the reference temperature, an error of the thermometer
    # through the CTE itself. Either stretches every ball by the same strain, in all poses alike.
    doubt = artefact.cte_standard_uncertainty_per_k * warmer_k if assumptions.cte else 0.0
    return {
        "machines": _machine_fields(field, seen),
        "deflection": _deflection_field(assumptions, seen),
        CTE: stretched * doubt,
        TEMPERATURE: stretched * (artefact.cte_per_k * assumptions.thermometer_uncertainty_k),
        DRIFT: _drift_fields(problem, assumptions.drift_mm),
        **{effect.name: effect.fields(assumptions.family.model, seen) for effect in assumptions.effects},
    }


def _transposed_rotations(problem: IdentificationProblem) -> Array:
    """Return the transposed rotations (K, 3, 3) of the poses, by which artefact points (K, width, 3) are multiplied
    from the right."""
    return problem.poses.rotation.transpose(0, 2, 1)


def _machine_fields(field: FieldForm, seen: Observations) -> Array:
    """Return the fields (n, 3, t) in mm of one standard deviation of each of the t parameters of the true machines'
    family."""
    family = field.assumptions.family
    scale = family.prior_standard_deviation
    return deviation_basis_of_tools(family.model, seen.axis_positions, seen.tool, seen.tool_offsets, scale)


def _deflection_field(assumptions: TruthAssumptions, seen: Observations) -> Array:
    if assumptions.deflection is None:
        return np.zeros((seen.size, 3, 0))
    return clamped_deflection(assumptions.deflection, seen.axis_positions)[:, :, None]


def _drift_fields(problem: IdentificationProblem, drift_mm: float) -> Array:
    """Return the drift fields (n, 3, 3K) in mm. In each position and direction there is an independent drift, which
    rises linearly over the balls of the position in row order."""
    layout = problem.layout
    if drift_mm == 0.0:
        return np.zeros((problem.observations.size, 3, 0))
    number = layout.unpad(np.tile(np.arange(float(layout.width)), (layout.positions, 1)))
    # from 0 at the first ball of a position to 1 at its last; a position with a single ball does not drift
    share = number / np.maximum(layout.counts - 1, 1)[layout.index]
    fields = np.zeros((len(share), 3, layout.positions, 3))
    fields[np.arange(len(share)), :, layout.index, :] = drift_mm * share[:, None, None] * np.eye(3)
    return fields.reshape(len(share), 3, -1)


def _machine_residuals(field: FieldForm, answers: Array) -> Array:
    """Return the residuals (u, t), true minus identified parameters, for one standard deviation of each of the t true
    parameters."""
    left = np.zeros((field.size, len(field.true_indices)))
    left[field.true_indices, np.arange(len(field.true_indices))] = field.assumptions.family.prior_standard_deviation
    # An identified parameter is compensated by its response; a parameter that the model lacks remains whole.
    left[field.model_indices] -= answers
    return left


def _moments(field: FieldForm, columns: Array) -> Array:
    return _embed(field, columns @ columns.T)


def _embed(field: FieldForm, covariance: Array) -> Array:
    """Embed second moments (p, p) of the identified parameters in a matrix (u, u) of the joint model."""
    moments = np.zeros((field.size, field.size))
    moments[np.ix_(field.model_indices, field.model_indices)] = covariance
    return moments


def _root(raw: float, aligned: float) -> VolumetricRms:
    return VolumetricRms(float(np.sqrt(max(raw, 0.0))), float(np.sqrt(max(aligned, 0.0))))
