"""What a set-up will see of a machine, before anything is measured, and the field that stays hidden from it.

Take the parameters z in units of their prior, z ~ N(0, 1), and C (p, p) for their posterior covariance, marginal over
certificate, thermal strain and misfit. The estimate answers a machine z with (1 - C) z in the mean over all noise: C z
is the part of the machine that it does not follow, whether because nothing shows it or because noise hides it. Of C z
the projection on the null space N of the measurements stays however often they are repeated. So over the prior

    unseen field   covariance C C,     tends to the blind field as noise tends to nothing
    blind field    covariance N Nᵀ

and the mean square over the workspace is a quadratic form of them, for the tools that measure and for any other one.
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
    """A tool whose field over a grid is looked at. `measured`: the set is measured with it."""

    name: str
    form: QuadraticForm
    measured: bool


@dataclass(frozen=True, eq=False)
class UnseenField:
    """Rms over the workspace in mm, after the best rigid motion, of the field at one tool offset (3,) mm.

    `prior_mm`: the family without any compensation; `unseen_mm`: what the estimate will not follow; `blind_mm`: the
    part of it that no repetition brings to light.
    """

    tool: str
    tool_offset: Array
    measured: bool
    prior_mm: float
    unseen_mm: float
    blind_mm: float


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Rank, null directions and conditioning of the measurements alone; standard deviations (p,) of the parameters
    before and after in mm or rad; the unseen field at each viewpoint."""

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
        """Rms of the unseen field over workspace and viewpoints."""
        return float(np.sqrt(np.mean([at.unseen_mm**2 for at in self.fields])))

    @property
    def blind_mm(self) -> float:
        """Rms of the blind field over workspace and viewpoints."""
        return float(np.sqrt(np.mean([at.blind_mm**2 for at in self.fields])))


def assess_identifiability(estimate: Estimate, viewpoints: Sequence[EvaluatedTool]) -> Identifiability:
    """What the measurements behind `estimate` see. Its values do not matter, only where the balls were.

    Holds for full weights with the family as prior: then the covariance of the estimate is that of the posterior.
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
    """(p, p) of the part of a drawn machine that an estimate with posterior covariance (p, p) does not follow.

    In units of `prior_scale` (p,) it is C C; a parameter that the family excludes has no part in it.
    """
    used = prior_scale > 0.0
    weights = np.zeros_like(prior_scale)
    weights[used] = prior_scale[used] ** -2
    return np.asarray(covariance @ (weights[:, None] * covariance))


def blind_covariance(information: Array, prior_scale: Array) -> Array:
    """(p, p) of the part of a drawn machine in the null space of an information matrix (p, p) in prior units."""
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
