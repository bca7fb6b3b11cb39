"""Test for a sudden change of the machine while the set was measured, for example by a collision.

The hypothesis is that one error has jumped at one instant: the balls measured before it saw the machine of the
estimate, and the balls after it saw a machine whose coefficients differ by a vector a. The rows of the design matrix
that belong to the error, with zeros before the instant, are the columns D of the further unknowns a. Let r be the
whitened residuals of the solution, σ the noise, A the whitened design matrix with the poses projected out, and C the
posterior covariance of the unknowns. The score and the information of a are then

    s = -Dᵀr/σ²,   F = DᵀD/σ² - DᵀA C AᵀD/σ⁴,

and module `twin.identification.jump` gives the likelihood ratio of the hypothesis. Both are sums over the rows after
the instant, so that one pass over the rows, from the last to the first, serves all instants.

All errors and instants are equally likely beforehand. The mean of their likelihood ratios has the expected value 1 if
the machine has not changed, so it exceeds 1/α with a probability of at most α (Markov). A change before the first ball,
which matters if the estimate of earlier nights is the prior, is no change in the run. If it explains the measurements
better than no change, the ratio is taken against it instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.centres import CentreEquations
from twin.identification.checks.outliers import Rows, WhitenedResiduals
from twin.identification.hidden_step import HiddenStep, StepVisibility
from twin.identification.jump import (
    ErrorCoefficients,
    SuspectedJump,
    jump_evidence,
    largest_false_alarm,
    log_mean_ratio,
    suspected_jump,
)
from twin.identification.poses import weighted
from twin.identification.problem import IdentificationProblem
from twin.identification.solution import Solution

_SHARE = 0.95  # probability of the interval of instants that is named, and of all named errors together
_JUMP = 1.0  # standard deviation of a jump, in units of the family

Place = tuple[int, int]


@dataclass(frozen=True)
class SuspectedStep:
    """Error that may have jumped in a run, between the balls `last_before` and `first_after`, each given by the index
    of its position and its ball number.

    `probability` is that of this error if one error has jumped. The jump lies between both balls with a probability of
    95 %; it has the size `jump` at the likeliest instant.
    """

    jump: SuspectedJump
    probability: float
    last_before: Place
    first_after: Place

    @property
    def text(self) -> str:
        """The step in words, with its place."""
        (earlier, last), (later, first) = self.last_before, self.first_after
        if earlier == later:
            return f"{self.jump.text} in position {earlier} between balls {last} and {first}"
        return f"{self.jump.text} between position {earlier}, ball {last}, and position {later}, ball {first}"

    def numbered(self, numbers: Sequence[int]) -> SuspectedStep:
        """Return the same step with the number (K,) of each position in place of its index."""
        (earlier, last), (later, first) = self.last_before, self.first_after
        return replace(self, last_before=(numbers[earlier], last), first_after=(numbers[later], first))


@dataclass(frozen=True)
class StepInRun:
    """Result of the test for a sudden change of the machine in a run.

    `log_ratio` is the natural logarithm of the mean likelihood ratio of a step of one error at one instant, against no
    step. `suspects` are the likeliest errors, the likeliest first; together they have a probability of 95 % or more if
    there was a step. `hidden` is the largest step that the test would not have found with certainty; None if there are
    no two positions between which it could have happened.
    """

    log_ratio: float
    suspects: tuple[SuspectedStep, ...]
    hidden: HiddenStep | None

    @property
    def false_alarm(self) -> float:
        """Upper limit of the probability that a machine without a step gives this ratio or a larger one."""
        return largest_false_alarm(self.log_ratio)

    def numbered(self, numbers: Sequence[int]) -> StepInRun:
        """Return the same result with the number (K,) of each position in place of its index."""
        hidden = None if self.hidden is None else self.hidden.numbered(numbers)
        return replace(self, suspects=tuple(one.numbered(numbers) for one in self.suspects), hidden=hidden)


@dataclass(frozen=True, eq=False)
class _StepHypotheses:
    """Score and information of a step of each of E errors at each of n instants; instant i lies before row i in the
    order of measuring.

    `score` (n, E, m) and `information` (n, E, m, m) refer to the coefficients of each error; an error with fewer
    coefficients than m has zeros in its last places. `rows` (n,) contains the sorted row of each place in the order of
    measuring.
    """

    problem: IdentificationProblem
    coefficients: ErrorCoefficients
    score: Array
    information: Array
    rows: Rows

    def result(self, hidden: HiddenStep | None) -> StepInRun:
        """Return the result of the test with the largest `hidden` step."""
        evidence = jump_evidence(self.score, self.information, _JUMP)[0]
        within = evidence[1:]
        if not within.size:
            return StepInRun(0.0, (), hidden)
        log_ratio = log_mean_ratio(within) - max(0.0, log_mean_ratio(evidence[0]))
        odds = np.exp(within - within.max())
        odds /= odds.sum()
        by_error = odds.sum(axis=0)
        ranked = np.argsort(-by_error)
        named = ranked[: int(np.searchsorted(np.cumsum(by_error[ranked]), _SHARE)) + 1]
        return StepInRun(log_ratio, tuple(self._suspect(int(one), odds[:, one]) for one in named), hidden)

    def _suspect(self, number: int, odds: Array) -> SuspectedStep:
        """Return the suspected step of an error with the probabilities `odds` (n - 1,) of the instants 1 to n - 1."""
        size, instant = len(self.coefficients.of_error(number)), 1 + int(odds.argmax())
        score = self.score[instant, number, :size]
        information = self.information[instant, number, :size, :size]
        likely = np.cumsum(odds) / odds.sum()
        first = 1 + int(np.searchsorted(likely, 0.5 * (1.0 - _SHARE)))
        last = 1 + int(np.searchsorted(likely, 0.5 * (1.0 + _SHARE)))
        return SuspectedStep(
            suspected_jump(self.problem.unknowns, self.coefficients.errors[number], score, information, _JUMP),
            min(float(odds.sum()), 1.0),  # a sum can exceed 1 by its rounding
            self._place(min(first, instant) - 1),
            self._place(max(last, instant)),
        )

    def _place(self, instant: int) -> Place:
        seen, row = self.problem.observations, self.rows[min(instant, len(self.rows) - 1)]
        return int(seen.position[row]), int(seen.ball[row])


def step_in_run(solution: Solution, found: WhitenedResiduals, measured: Rows, tool_offset: Array) -> StepInRun:
    """Test for a sudden change of the machine in a run.

    `found` are the residuals of the solution. `measured` (n,) contains the place in the order of measuring of each of
    the n rows, which are sorted by position. Positions follow each other as their first rows do. `tool_offset` (3,) in
    mm is that of the tool for which the volumetric error is stated. Raise DataError if the solution is not in the
    formulation `centres`.
    """
    equations, problem = solution.equations, solution.equations.problem
    if not isinstance(equations, CentreEquations):
        raise DataError("the test for a step in a run requires the formulation 'centres'")
    rows, order = _in_order_of_measuring(problem.layout.counts, measured)
    visibility = StepVisibility.of(equations, solution.covariance, solution.scales.noise, tool_offset)
    hidden = visibility.largest_in_order(order)
    # positions of the problem are those with accepted rows
    used = np.unique(problem.observations.position).tolist()
    return _hypotheses(problem, found, rows).result(None if hidden is None else hidden.numbered(used))


def evidence_of_step(problem: IdentificationProblem, found: WhitenedResiduals, measured: Rows) -> float:
    """Return `log_ratio` of `step_in_run` for the residuals `found` of a solution of `problem`."""
    rows, _ = _in_order_of_measuring(problem.layout.counts, measured)
    return _hypotheses(problem, found, rows).result(None).log_ratio


def _hypotheses(problem: IdentificationProblem, found: WhitenedResiduals, rows: Rows) -> _StepHypotheses:
    coefficients = ErrorCoefficients.of(problem.unknowns)
    chosen, present = coefficients.columns, coefficients.present
    design = problem.layout.unpad(problem.design[..., chosen.reshape(-1)])[rows]
    design = weighted(found.whitening[rows], design).reshape(len(rows), 3, *chosen.shape) * present
    basis, root, residuals = found.pose_basis[rows], found.unknowns_root[rows], found.residuals[rows]
    score = -_suffix_sums(np.einsum("nief,ni->nef", design, residuals))
    index = problem.layout.index[rows]
    gram = _suffix_sums(np.einsum("nief,nieg->nefg", design, design)) - _taken_by_poses(design, basis, index)
    information = gram - _taken_by_unknowns(design, root) / found.variance
    # divided by the common scale of the residuals, as in the test for outliers
    unit = found.variance * found.scale
    return _StepHypotheses(problem, coefficients, score / unit, information / unit, rows)


def _in_order_of_measuring(counts: Rows, measured: Rows) -> tuple[Rows, list[int]]:
    """Return the sorted rows (n,) in the order of measuring, and the positions in this order."""
    ends = np.cumsum(counts)
    parts = [start + np.argsort(measured[start:end]) for start, end in zip(ends - counts, ends, strict=True)]
    order = sorted(range(len(parts)), key=lambda position: int(measured[parts[position][0]]))
    return np.concatenate([parts[position] for position in order]), order


def _suffix_sums(parts: Array) -> Array:
    """Return the sums (n, ...) of the rows from each row to the last."""
    return np.asarray(np.cumsum(parts[::-1], axis=0)[::-1])


def _taken_by_poses(design: Array, basis: Array, position: Rows) -> Array:
    """Return the part (n, E, m, m) of DᵀD that the poses take up, for the step before each row."""
    taken = np.empty((len(design), *design.shape[2:], design.shape[3]))
    carried = np.einsum("nip,nief->nepf", basis, design)
    later = np.zeros(taken.shape[1:])
    for number in reversed(dict.fromkeys(position.tolist())):
        rows = position == number
        through = _suffix_sums(carried[rows])
        squares = np.einsum("nepf,nepg->nefg", through, through)
        taken[rows] = later + squares
        later = later + squares[0]
    return taken


def _taken_by_unknowns(design: Array, root: Array) -> Array:
    """Return DᵀA C AᵀD (n, E, m, m), divided by the variance of the noise, for the step before each row."""
    rows, _, errors, size = design.shape
    taken = np.empty((rows, errors, size, size))
    # A summand per row would need n m E P numbers at once
    through = np.zeros((errors * size, root.shape[2]))
    for row in range(rows - 1, -1, -1):
        through += design[row].reshape(3, -1).T @ root[row]
        part = through.reshape(errors, size, -1)
        taken[row] = part @ part.transpose(0, 2, 1)
    return taken
