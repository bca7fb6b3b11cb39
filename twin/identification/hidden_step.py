"""Largest sudden change of the machine that a set of positions could hide, if it happens between two positions.

A step a of the coefficients of one error, which only the positions after it see, shifts the estimate. Let M be the
information of these positions (sum of AᵀA/σ² with the whitened design matrix A of a position, whose pose is projected
out, and the noise σ), C the posterior covariance of the unknowns with all positions, and J the matrix that selects the
coefficients. The estimate is then C M J a away from the machine before the step, and a - C M J a from the machine
after it. The table suits one of the two better than the other, and that one counts: a step that only the last position
could have seen is like one after the run, about which no set of positions can say anything.

The step test (module `twin.identification.checks.step_in_run`) finds the step with the noncentrality

    λ = aᵀF a,   F = Jᵀ(M - M C M)J,

with a probability of 95 % if λ exceeds a limit that follows from the false alarm rate of the test. A step with the
shape that is typical of the machine's family and just this noncentrality leaves the mean square error

    λ trace(B) / trace(F)

over the workspace, where B is the quadratic form of the error that remains. Coefficients are in units of their standard
deviations in the family.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification.centres import CentreEquations
from twin.identification.jump import ERRORS, ErrorCoefficients
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.options import Options
from twin.identification.problem import build_problem
from twin.identification.scales import Scales
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import SQUARENESS
from twin.machine.machine_population import Family
from twin.machine.volumetric import QuadraticForm, evaluation_grid
from twin.units import MICRO_UNITS, UM_PER_MM

FALSE_ALARM = 0.01
"""Probability with which the step test may report a step of a machine that did not change."""

_POWER = 1.645  # quantile of the normal distribution for 95 %
_UNSEEN = 1e-9  # information about a step below which no size of it would be found


@dataclass(frozen=True)
class HiddenStep:
    """Sudden change of `error` that the step test finds with a probability of just 95 %, if it happens between the two
    positions `between`, which are given by their indices; None if the order of measuring is not known.

    It has the size `change` in `unit`: the change of the angle of a squareness, or the rms of the change of an error
    motion over the travel. The table then leaves the volumetric error `vce_um` that it would not leave without the
    step, after removal of the best-fitting rigid motion.
    """

    error: str
    change: float
    unit: str
    vce_um: float
    between: tuple[int, int] | None = None

    @property
    def text(self) -> str:
        """The step in words."""
        return f"{self.error} by {self.change:.1f} {self.unit}{'' if self.error in SQUARENESS else ' rms'}"

    @property
    def note(self) -> str:
        """Power of the test for the step, and the error that the step leaves unnoticed, in words."""
        where = "" if self.between is None else f" between positions {self.between[0]} and {self.between[1]}"
        found = "is found with a probability of 95 %; unnoticed, it would leave"
        return f"a change of {self.text}{where} {found} {self.vce_um:.1f} µm"

    def numbered(self, numbers: Sequence[int]) -> HiddenStep:
        """Return the same step with the number of each position in place of its index."""
        if self.between is None:
            return self
        earlier, later = self.between
        return replace(self, between=(numbers[earlier], numbers[later]))


@dataclass(frozen=True, eq=False)
class StepVisibility:
    """Visibility of a step between the K positions of a set with P unknowns, of which the first p are the parameters.

    `design` (K, r, P) contains A/σ of each position, where A is the whitened design matrix with the pose projected out.
    `covariance` (P, P) is the posterior covariance of the unknowns. `form` (p, p) is the quadratic form of the
    volumetric error, aligned, in mm² for parameters in units of their prior standard deviations.
    """

    unknowns: Unknowns
    design: Array
    covariance: Array
    form: Array

    @classmethod
    def of(cls, equations: CentreEquations, covariance: Array, noise: float, tool_offset: Array) -> StepVisibility:
        """Return the visibility of a step in measurements with these equations. `covariance` (P, P) is the posterior
        covariance of the unknowns, `noise` the scale of the noise, and `tool_offset` (3,) in mm that of the tool for
        which the table is made."""
        problem = equations.problem
        positions, unknowns = problem.layout.positions, problem.unknowns
        design = problem.layout.pad(equations.projected(problem.blocks.size)).reshape(positions, -1, len(covariance))
        form = QuadraticForm.build(unknowns.model, evaluation_grid(unknowns.model.ranges_mm), tool_offset).aligned
        return cls(unknowns, design / noise, covariance, form * np.multiply.outer(unknowns.scale, unknowns.scale))

    @classmethod
    def planned(
        cls, family: Family, artefact: Artefact, observations: Observations, options: Options, tool_offset: Array
    ) -> StepVisibility:
        """Return the visibility of a step in a planned measurement, whose ball centres are `observations`. All standard
        deviations are assumed to be as stated. Raise DataError if a ball is not on the artefact."""
        problem = build_problem(family, observations, artefact, options)
        equations = CentreEquations.build(problem, unit_weights=False)
        posterior = Posterior.of(equations.matrix, PriorPrecision(problem.blocks, problem.known), Scales())
        return cls.of(equations, posterior.covariance, 1.0, tool_offset)

    @cached_property
    def carried(self) -> Array:
        """C Aᵀ/σ (K, P, r) of each position, with the posterior covariance C of the unknowns."""
        rows = self.design.reshape(-1, len(self.covariance)) @ self.covariance
        return rows.reshape(self.design.shape).transpose(0, 2, 1)

    def restricted_to(self, positions: Sequence[int]) -> StepVisibility:
        """Return the visibility of a step if only the positions with these indices are measured, in this order."""
        left_out = np.delete(self.design, list(positions), axis=0).reshape(-1, len(self.covariance))
        precision = np.linalg.inv(self.covariance) - left_out.T @ left_out
        return replace(self, design=self.design[list(positions)], covariance=np.asarray(np.linalg.inv(precision)))

    def largest_in_order(self, order: Sequence[int]) -> HiddenStep | None:
        """Return the largest hidden step if the positions are measured in this order, given by their indices. Return
        None if there is no instant between two positions."""
        seen, shift = self._nothing_seen()
        found = list[HiddenStep]()
        for earlier, later in reversed(list(pairwise(order))):
            seen, shift = self._with(later, seen, shift)
            hidden = self._largest(seen, shift)
            found += [] if hidden is None else [replace(hidden, between=(earlier, later))]
        return max(found, key=lambda one: one.vce_um, default=None)

    def largest(self, after: Iterable[int]) -> HiddenStep | None:
        """Return the largest hidden step that only the positions with the indices `after` see. Return None if no size
        of a step would be found."""
        seen, shift = self._nothing_seen()
        for position in after:
            seen, shift = self._with(position, seen, shift)
        return self._largest(seen, shift)

    def _nothing_seen(self) -> tuple[Array, Array]:
        nothing = np.zeros((self.design.shape[2], len(self.form)))
        return nothing, nothing

    def _with(self, position: int, seen: Array, shift: Array) -> tuple[Array, Array]:
        """Return M and C M (P, p), to which this position has been added."""
        design = self.design[position][:, : len(self.form)]
        return seen + self.design[position].T @ design, shift + self.carried[position] @ design

    @cached_property
    def _coefficients(self) -> ErrorCoefficients:
        return ErrorCoefficients.of(self.unknowns)

    def _largest(self, seen: Array, shift: Array) -> HiddenStep | None:
        size, columns, present = len(self.form), self._coefficients.columns, self._coefficients.present
        information = seen[:size] - seen.T @ shift
        moved = shift[:size]
        rest = np.eye(size) - moved
        # diagonals of the quadratic forms of the errors that remain on the machine before and after the step
        before, later = (np.einsum("ij,ij->j", one, self.form @ one) for one in (moved, rest))
        left = np.minimum(*((one[columns] * present).sum(axis=1) for one in (before, later)))
        inner = information[columns[:, :, None], columns[:, None, :]] * present[:, :, None] * present[:, None, :]
        trace = np.einsum("eii->e", inner)
        hypotheses = len(ERRORS) * max(len(self.design) - 1, 1)
        penalty = np.maximum(np.linalg.slogdet(np.eye(columns.shape[1]) + inner)[1], 0.0)
        limit = np.sqrt(2.0 * math.log(hypotheses / FALSE_ALARM) + penalty) + _POWER
        found = trace > _UNSEEN
        if not found.any():
            return None
        # mean square of the coefficients' steps, times their number
        square = np.where(found, limit**2, 0.0) / np.where(found, trace, 1.0)
        squares = square * np.maximum(left, 0.0)
        largest = int(squares.argmax())
        change, unit = self._size(largest, math.sqrt(float(square[largest])))
        vce_um = UM_PER_MM * math.sqrt(float(squares[largest]))
        return HiddenStep(self._coefficients.errors[largest], change, unit, vce_um)

    def _size(self, number: int, size: float) -> tuple[float, str]:
        columns = self._coefficients.of_error(number)
        parameters = [self.unknowns.model.parameters[i] for i in columns]
        steps = size * self.unknowns.scale[columns]
        unit, factor = MICRO_UNITS[parameters[0].unit]
        if self._coefficients.errors[number] in SQUARENESS:
            return factor * float(steps[0]), unit
        # mean square of a Legendre polynomial of order n
        shares = np.array([1.0 / (2.0 * one.order + 1.0) for one in parameters])
        return factor * math.sqrt(float(shares @ steps**2)), unit
