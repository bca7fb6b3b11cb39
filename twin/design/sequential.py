"""Choice of the next position of the artefact from what was measured in the positions before.

The information that a position gives about the unknowns that all positions share does not depend on the order of
measuring: the pose of the artefact is projected out of its equations, so the normal equations of a set of positions are
the sums of those of the single positions. A position that has been measured is therefore added in milliseconds. The
scales and the Legendre order are then estimated anew by their evidence, from the scales of the step before. The
posterior covariance C of the unknowns follows from them, and from it the gain of each candidate, the decrease of
trace(Q C) (`twin.design.information`).

A set that is designed beforehand uses the scales of the machine file. Here the candidates are judged with the scales
that the machine itself has shown: if its rails are wavier than those of its family, positions that see the waves gain.

The choice of a position and the end of a run depend on measured values alone. The posterior is therefore the same as if
the positions had been fixed beforehand (Box and Tiao 1973, 1.3). Its intervals need not cover as stated for a machine
that is not of the population; `volcal study sequential` observes their coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions, Indices, build_candidates
from twin.design.criterion import Criterion
from twin.design.information import InformationState
from twin.design.procedure import Procedure
from twin.design.search import Mask
from twin.identification import Estimate, Options
from twin.identification.evidence import log_evidence, most_likely_scales
from twin.identification.normal import NormalEquations, Posterior, PriorPrecision
from twin.identification.order import likeliest_order
from twin.identification.problem import build_problem
from twin.identification.roll import build_measured_problem
from twin.identification.scales import Scales
from twin.identification.solution import free_precision, normal_equations
from twin.identification.unknowns import Unknowns
from twin.machine.machine_population import Family

MIN_FOR_SCALES = 3
"""Number of positions from which the scales and the order are estimated. With fewer, they are those stated."""


NEAR_TARGET = 0.75
"""Share of a target for the upper 95 % limit of the VCE from which a whole identification is worth its time. The upper
limit is about 1.4 times the expected VCE; a machine whose ratio is below 1.33 measures a position more than it must."""


@dataclass(frozen=True, eq=False)
class OrderModel:
    """Error model with one Legendre order: its prior, its unknowns, and the candidate positions in terms of them."""

    order: int
    family: Family
    candidates: CandidatePositions
    unknowns: Unknowns
    precision: PriorPrecision

    @classmethod
    def build(
        cls,
        order: int,
        family: Family,
        procedure: Procedure,
        positions: Sequence[Position],
        options: Options,
        grid: Array,
    ) -> OrderModel:
        """Build the model of `family`. `grid` (n, 3) in mm gives the axis positions over which the error counts. Raise
        DataError if none of the `positions` can be measured."""
        offset = procedure.layout().tool_offset_mm
        candidates = build_candidates(procedure, positions, family, options, grid, offset)
        planned = procedure.plan(candidates.positions[:1]).observations
        problem = build_problem(family, planned, procedure.artefact, options)
        return cls(order, family, candidates, problem.unknowns, free_precision(problem))

    @property
    def form(self) -> Criterion:
        return self.candidates.form

    def nothing(self) -> NormalEquations:
        size = self.precision.blocks.size
        return NormalEquations(np.zeros((size, size)), np.zeros(size), 0.0, 0)

    def equations(self, seen: Observations, artefact: Artefact, options: Options) -> NormalEquations:
        """Return the normal equations of the measured ball centres `seen`."""
        return normal_equations(build_measured_problem(self.family, seen, artefact, options))


@dataclass(frozen=True, eq=False)
class PositionsSeen:
    """Knowledge of the unknowns after some measured positions: the posterior of the likeliest of the `models`.

    `normals` contains the normal equations of all measured positions for each model. `chosen` is the index of the
    likeliest model, and `scales` are its likeliest scales. `count` is the number of measured positions. `estimate` is a
    whole identification of the same positions whose posterior takes the place of the one from `normals`, or None.
    """

    models: tuple[OrderModel, ...]
    artefact: Artefact
    options: Options
    normals: tuple[NormalEquations, ...]
    scales: Scales
    chosen: int
    count: int = 0
    estimate: Estimate | None = None

    @classmethod
    def none(cls, models: Sequence[OrderModel], artefact: Artefact, options: Options, order: int) -> PositionsSeen:
        """Return the state before the first position. `order` is the stated order of the machine; if there is no model
        of this order, the one nearest to it is assumed."""
        nearest = min(range(len(models)), key=lambda index: abs(models[index].order - order))
        nothing = tuple(model.nothing() for model in models)
        return cls(tuple(models), artefact, options, nothing, Scales(), nearest)

    @property
    def model(self) -> OrderModel:
        return self.models[self.chosen]

    def after(self, seen: Observations) -> PositionsSeen:
        """Return the state after the ball centres `seen` of one more position, with the scales and the order that are
        now the likeliest."""
        added = (model.equations(seen, self.artefact, self.options) for model in self.models)
        normals = tuple(before.plus(more) for before, more in zip(self.normals, added, strict=True))
        known = replace(self, normals=normals, count=self.count + 1, estimate=None)
        return known if known.count < MIN_FOR_SCALES else known._estimated()

    def with_estimate(self, estimate: Estimate) -> PositionsSeen:
        """Return the state with the posterior of `estimate`, a whole identification of the same positions. It includes
        the drift of the machine, rejected balls and the uncertainty of the scales.

        If the estimate has other unknowns, for example balls that contradict their certificate, the state stays.
        """
        orders = [model.order for model in self.models]
        order = max(estimate.model.highest_order)
        if order not in orders:
            return self
        chosen = orders.index(order)
        if len(estimate.z) != self.models[chosen].precision.blocks.size:
            return self
        return replace(self, chosen=chosen, scales=estimate.scales, estimate=estimate)

    def planned(self, index: int) -> PositionsSeen:
        """Return the state after candidate `index` has been measured, before its values are known: the information of
        the chosen model grows, and the scales stay."""
        factor = self.model.candidates.factors[index]
        known = self.normals[self.chosen]
        grown = replace(known, matrix=known.matrix + factor.T @ factor, rows=known.rows + len(factor))
        normals = tuple(grown if number == self.chosen else one for number, one in enumerate(self.normals))
        return replace(self, normals=normals, count=self.count + 1)

    @cached_property
    def _posterior(self) -> Posterior:
        return Posterior.of(self.normals[self.chosen].matrix, self.model.precision, self.scales)

    @property
    def covariance(self) -> Array:
        """Posterior covariance (P, P) of the P unknowns of the chosen model at the likeliest scales."""
        return self._posterior.covariance if self.estimate is None else self.estimate.z_covariance

    @property
    def expected_vce_mm(self) -> float:
        """Expected volumetric compensated error (VCE) in mm at the likeliest scales, after the best-fitting rigid
        motion has been removed. The uncertainty of the scales is not included."""
        known, unknowns, blocks = self.normals[self.chosen], self.model.unknowns, self.model.precision.blocks
        z = self._posterior.solve(known.right / self.scales.noise**2) if self.estimate is None else self.estimate.z
        left = np.zeros_like(z)  # the table does not correct the misfit, so its estimate remains as an error
        left[blocks.misfit] = z[blocks.misfit]
        form = self.model.form.aligned
        square = float(np.vdot(form, self.covariance)) + float(left @ form @ left)
        return float(np.sqrt(max(square + 3.0 * unknowns.unresolved_mm2(self.scales), 0.0)))

    def is_near(self, target_mm: float) -> bool:
        """Return True if the upper 95 % limit of the VCE may be below `target_mm`."""
        return self.expected_vce_mm <= NEAR_TARGET * target_mm

    def gains(self, allowed: Mask) -> Array:
        """Return the gain (N,) in mm² of each of the N candidates in the mask `allowed`, the decrease of the expected
        mean square error if it is measured next. The gain of all other candidates is 0."""
        candidates, at = self.model.candidates, np.flatnonzero(allowed)
        found = np.zeros(candidates.count)
        if at.size:
            factors = candidates.factors[at] / self.scales.noise
            found[at] = InformationState.initial(factors, candidates.form.aligned, self.covariance).gains()
        return found

    def _estimated(self) -> PositionsSeen:
        """Return the state with the likeliest scales and order. The search begins at the present ones; the other orders
        are compared at the scales of the present order."""
        renewed = self._with_scales()
        logs = {
            model.order: log_evidence(normal, model.precision, renewed.scales)
            for model, normal in zip(self.models, self.normals, strict=True)
        }
        best = likeliest_order(logs)
        if best == self.model.order:
            return renewed
        chosen = next(index for index, model in enumerate(self.models) if model.order == best)
        return replace(renewed, chosen=chosen)._with_scales()

    def _with_scales(self) -> PositionsSeen:
        model, normal = self.model, self.normals[self.chosen]
        return replace(self, scales=most_likely_scales(normal, model.precision, self.scales))


def ranked_choices(seen: PositionsSeen, seconds: Array, allowed: Mask) -> Indices:
    """Return the indices of the candidates in the mask `allowed` (N,), the one with the largest gain per second first.
    `seconds` (N,) is the time that each of them takes from where the machine stands. Candidates without a gain are left
    out."""
    worth = seen.gains(allowed) / seconds
    order = np.argsort(-worth, kind="stable")
    return np.asarray(order[worth[order] > 0.0])
