"""Identifiability of a machine by a planned set-up, and the part of the error field that remains hidden from this
set-up.

The p parameters are collected in a vector z in units of their prior standard deviations, so that a priori z has mean
zero and covariance 1. Let C (p, p) be the posterior covariance of z, marginal over certificate, thermal strain and
misfit. For a machine with the parameters z, the mean of the estimate over all noise is (1 - C) z. The estimate does not
follow the remaining part C z, either because the measurements do not depend on it or because noise hides it. The part
of C z that lies in the null space of the measurements remains, no matter how often they are repeated. If the columns of
N are an orthonormal basis of this null space, the two parts have these covariances over the prior:

    unseen field   covariance C C,     tends to the blind field as the noise tends to zero
    blind field    covariance N Nᵀ

The mean square of each field over the workspace is a quadratic form of the parameters. It is computed for the measuring
tools and for any other tool.
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
    """Tool for which the field over a grid is evaluated.

    `form` is the quadratic form of the mean square field of the tool. `measured` is True if the position set is
    measured with this tool.
    """

    name: str
    form: QuadraticForm
    measured: bool


@dataclass(frozen=True, eq=False)
class UnseenField:
    """Rms values in mm of error fields over the workspace for one tool, after the best-fitting rigid motion has been
    removed.

    `tool_offset` (3,) is in mm; `measured` is True if the position set is measured with this tool. `prior_mm` is the
    rms of the field of the family of machines without compensation. `unseen_mm` is the rms of the part of the field
    that the estimate will not follow. `blind_mm` is the rms of the part that no repetition of the measurements can
    reveal.
    """

    tool: str
    tool_offset: Array
    measured: bool
    prior_mm: float
    unseen_mm: float
    blind_mm: float


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of the p parameters by a set-up.

    `rank`, `null_directions` and `conditioning` describe the measurements alone. `prior_sigma` (p,) and
    `posterior_sigma` (p,) are the standard deviations of the parameters, in mm or rad, before and after the
    measurement. `fields` contains the unseen field of each evaluated tool.
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
        """One line for each kind of null direction."""
        return summary(self.null_directions)

    @property
    def unseen_mm(self) -> float:
        """Rms of the unseen field over the workspace and the evaluated tools, in mm."""
        return float(np.sqrt(np.mean([at.unseen_mm**2 for at in self.fields])))

    @property
    def blind_mm(self) -> float:
        """Rms of the blind field over the workspace and the evaluated tools, in mm."""
        return float(np.sqrt(np.mean([at.blind_mm**2 for at in self.fields])))


def assess_identifiability(estimate: Estimate, viewpoints: Sequence[EvaluatedTool]) -> Identifiability:
    """Return the identifiability given by the measurements behind `estimate`. Only the ball positions matter, not the
    measured values.

    The result is valid only if the estimate has full weights and the family as prior, because the covariance of the
    estimate is then the posterior covariance.
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
    """Return the covariance (p, p) in mm and rad of the part of a random machine that the estimate does not follow.

    `covariance` (p, p) is the posterior covariance; in units of `prior_scale` (p,) it is called C, and the result is C
    C. A parameter that the family holds at zero does not contribute.
    """
    used = prior_scale > 0.0
    weights = np.zeros_like(prior_scale)
    weights[used] = prior_scale[used] ** -2
    return np.asarray(covariance @ (weights[:, None] * covariance))


def blind_covariance(information: Array, prior_scale: Array) -> Array:
    """Return the covariance (p, p) in mm and rad of the part of a random machine that lies in the null space of
    `information` (p, p).

    The information matrix refers to parameters in units of `prior_scale` (p,).
    """
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
