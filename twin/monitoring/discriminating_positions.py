"""Positions that best show if an error has jumped, or which of several suspected errors has jumped.

The measurement of a position with the information factor W responds to a change a of the unknowns z with W a. Touch
noise and the covariance C of z give this response the covariance 1 + W C Wᵀ. The detectability of the change is the
noncentrality of the χ² test, aᵀWᵀ(1 + W C Wᵀ)⁻¹W a. If a is the difference of two suspected jumps, the detectability is
twice the divergence between them (Box & Hill, Technometrics 9, 1967).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.design.candidates import CandidatePositions
from twin.identification.unknowns import Unknowns
from twin.monitoring.step_detection import ERRORS


@dataclass(frozen=True, eq=False)
class JumpQuestions:
    """Questions that further measurements should answer about possible jumps of the errors.

    `shifts` (m, P) contains m possible shifts of the unknowns z. `weights` (q, m) contains, for each of the q
    questions, the weights with which the noncentralities of the shifts are added up.
    """

    shifts: Array
    weights: Array

    @classmethod
    def which_jump(cls, jumps: Array) -> JumpQuestions:
        """Return one question for each pair of the `jumps` (k, P): which of the two jumps has occurred?"""
        pairs = np.array(list(combinations(range(len(jumps)), 2)), dtype=np.intp).reshape(-1, 2)
        return cls(jumps[pairs[:, 0]] - jumps[pairs[:, 1]], np.eye(len(pairs)))

    @classmethod
    def any_jump(cls, unknowns: Unknowns) -> JumpQuestions:
        """Return one question for each error: has this error jumped?

        Each coefficient is shifted by its standard deviation in the family of machines.
        """
        names = np.array([parameter.error for parameter in unknowns.model.parameters])
        moves = np.eye(len(names), unknowns.blocks.size)
        return cls(moves, np.array([names == error for error in ERRORS], dtype=np.float64))

    def noncentralities(self, factors: Array, covariance: Array) -> Array:
        """Return the noncentralities (N, q) that N positions with the information `factors` (N, r, P) give for the
        questions.

        `covariance` (P, P) is the covariance of z before these positions are measured.
        """
        seen = factors @ self.shifts.T
        noise = np.eye(factors.shape[1]) + factors @ covariance @ factors.transpose(0, 2, 1)
        return np.asarray(np.einsum("nrm,nrm->nm", seen, np.linalg.solve(noise, seen)) @ self.weights.T)


def rank_discriminating_positions(
    candidates: CandidatePositions,
    measured: list[int],
    questions: JumpQuestions,
    allowed: NDArray[np.bool_],
    minutes: Array,
) -> Iterator[int]:
    """Yield the indices of the candidates in the order in which they should be measured, each by the largest value per
    minute.

    The value of a candidate assumes that `measured` and all candidates yielded earlier have been measured. `allowed`
    (N,) marks the candidates that may be chosen, each once; `minutes` (N,) is the time that each needs. The value is
    the increase of the sum of ln(1 + noncentrality) over the questions, so questions that are already answered count
    little.
    """
    left, chosen = allowed.copy(), list(measured)
    obtained = _answered(candidates, measured, questions)
    while left.any():
        each = questions.noncentralities(candidates.factors, candidates.covariance(chosen))
        value = (np.log1p(obtained + each) - np.log1p(obtained)).sum(axis=1) / minutes
        best = int(np.argmax(np.where(left, value, -np.inf)))
        yield best
        left[best] = False
        chosen.append(best)
        obtained = obtained + each[best]


def _answered(candidates: CandidatePositions, measured: list[int], questions: JumpQuestions) -> Array:
    """Return the noncentralities (q,) that the positions `measured`, taken in the given order, have already
    contributed."""
    obtained = np.zeros(len(questions.weights))
    for number, index in enumerate(measured):
        before = candidates.covariance(measured[:number])
        obtained = obtained + questions.noncentralities(candidates.factors[index : index + 1], before)[0]
    return obtained
