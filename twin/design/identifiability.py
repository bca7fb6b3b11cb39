"""Identifiability of the error parameters of a machine by a planned set-up (tools, artefact and positions), and the
part of the machine's error field that remains hidden from this set-up.

The vector z contains the p parameters of the error model in units of their prior standard deviations. A priori, z has
mean zero and the unit matrix as covariance. Let C (p, p) be the posterior covariance of z, including the uncertainty
due to the artefact certificate, the thermal strain and the misfit. For a machine with the parameters z, the mean of the
estimate over all noise is (1 - C) z. The remaining part C z is missing from the estimate, either because the
measurements do not depend on this part or because noise hides it. The part of z in the null space of the measurements
remains missing, no matter how often the measurements are repeated. Let the columns of a matrix N be an orthonormal
basis of this null space. The missing part C z causes the unseen field, and the part in the null space causes the blind
field. Over machines drawn from the prior, the two parts have these covariances:

    unseen field   covariance C C,     tends to the blind field as the noise tends to zero
    blind field    covariance N Nᵀ

The mean square of each field over the workspace is a quadratic form of the parameters. The mean square is computed for
the tools used in the measurement and for other tools.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.arrays import Array
from twin.identification import Estimate
from twin.identification.observability import NullDirection, null_space, summary
from twin.machine.error_model import ErrorModel
from twin.machine.volumetric import QuadraticForm


@dataclass(frozen=True, eq=False)
class EvaluatedTool:
    """Tool for which the error field over a grid is evaluated.

    `form` is the quadratic form of the model parameters that gives the mean square of the error field for this tool.
    `measured` is True if the position set is measured with this tool.
    """

    name: str
    form: QuadraticForm
    measured: bool


@dataclass(frozen=True, eq=False)
class UnseenField:
    """Rms values in mm of error fields over the workspace for one tool, after the best-fitting rigid motion has been
    removed.

    `tool_offset` (3,) is the offset of the tool in mm; `measured` is True if the position set is measured with this
    tool. `prior_mm` is the rms of the error field, without compensation, of machines drawn from the prior population.
    `unseen_mm` is the rms of the part of the field that is missing from the estimate of the machine's errors, because
    the measurements do not show it or because noise hides it. `blind_mm` is the rms of the part of the field that no
    repetition of the measurements can reveal.
    """

    tool: str
    tool_offset: Array
    measured: bool
    prior_mm: float
    unseen_mm: float
    blind_mm: float


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of the p parameters of an error model by a measuring set-up.

    `rank`, `null_directions` and `conditioning` describe the measurements alone, without the prior: the number of
    parameter combinations that they determine, the combinations that they do not determine, and the ratio of the
    largest to the smallest singular value of the determined ones. `prior_sigma` (p,) and `posterior_sigma` (p,) are the
    standard deviations of the parameters, in mm or rad, before and after the measurement. `fields` contains, for each
    evaluated tool, the rms of the error field that remains hidden.
    """

    model: ErrorModel
    rank: int
    null_directions: tuple[NullDirection, ...]
    conditioning: float
    prior_sigma: Array = field(repr=False)
    posterior_sigma: Array = field(repr=False)
    fields: tuple[UnseenField, ...]

    @property
    def null_summary(self) -> tuple[str, ...]:
        """Description of the null directions, with one line for each kind of null direction."""
        return summary(self.null_directions)

    @property
    def unseen_mm(self) -> float:
        """Rms in mm, over the workspace and the evaluated tools, of the part of the error field that is missing from
        the estimate (the unseen field)."""
        return float(np.sqrt(np.mean([at.unseen_mm**2 for at in self.fields])))

    @property
    def blind_mm(self) -> float:
        """Rms in mm, over the workspace and the evaluated tools, of the part of the error field that no repetition of
        the measurements can reveal (the blind field)."""
        return float(np.sqrt(np.mean([at.blind_mm**2 for at in self.fields])))


def assess_identifiability(estimate: Estimate, viewpoints: Sequence[EvaluatedTool]) -> Identifiability:
    """Return the identifiability of the parameters by the measurements from which `estimate` was computed. The result
    depends on the axis positions at which balls were measured, but not on the measured errors. The error fields are
    evaluated for the tools in `viewpoints`.

    The result is valid only if the observations in the estimate are weighted by their covariances (full weights) and
    the prior is the prior population of machines (the family). Only then is the covariance of the estimate the
    posterior covariance.
    """
    return Identifiability(
        model=estimate.model,
        rank=estimate.rank,
        null_directions=estimate.null_directions,
        conditioning=estimate.conditioning,
        prior_sigma=estimate.prior_scale,
        posterior_sigma=estimate.standard_uncertainty,
        fields=_unseen_fields(estimate, viewpoints),
    )


def unseen_covariance(covariance: Array, prior_scale: Array) -> Array:
    """Return the covariance (p, p), in mm and rad, of the difference between the true parameters and their expected
    estimate. A difference remains if the measurements do not show a parameter or if noise hides it. The covariance is
    taken over random machines of the prior population.

    `covariance` (p, p) is the posterior covariance of the parameters. If C is this covariance in units of `prior_scale`
    (p,), the result in the same units is the product C C. A parameter that the family holds at zero does not
    contribute.
    """
    used = prior_scale > 0.0
    weights = np.zeros_like(prior_scale)
    # S² C C in units of the prior is C D⁻² C in mm and rad, where D = diag(prior_scale)
    weights[used] = prior_scale[used] ** -2
    return np.asarray(covariance @ (weights[:, None] * covariance))


def blind_covariance(information: Array, prior_scale: Array) -> Array:
    """Return the covariance (p, p), in mm and rad, of the part of the parameters that lies in the null space of the
    measurements. The covariance is taken over random machines of the prior population.

    `information` (p, p) is the information matrix of the measurements for parameters in units of `prior_scale` (p,).
    """
    # N in the units of the parameters, mm and rad
    hidden = prior_scale[:, None] * null_space(information)
    return np.asarray(hidden @ hidden.T)


def _unseen_fields(estimate: Estimate, viewpoints: Sequence[EvaluatedTool]) -> tuple[UnseenField, ...]:
    prior = np.diag(estimate.prior_scale**2)
    unseen = unseen_covariance(estimate.covariance, estimate.prior_scale)
    blind = blind_covariance(estimate.information, estimate.prior_scale)
    return tuple(
        UnseenField(
            tool=view.name,
            tool_offset=view.form.tool_offset,
            measured=view.measured,
            prior_mm=view.form.expected(prior).aligned_mm,
            unseen_mm=view.form.expected(unseen).aligned_mm,
            blind_mm=view.form.expected(blind).aligned_mm,
        )
        for view in viewpoints
    )
