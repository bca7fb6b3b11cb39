"""Choice of positions whose measurement best shows if an error has jumped, or which of several errors has jumped.

A position is described by its information factor W: WᵀW is the information (the inverse covariance) that its ball
centres give about the unknowns z of the identification. If z changes by a, the measurement of the position, scaled to
unit noise, changes by W a. Touch noise and the covariance C of z give this measurement the covariance I + W C Wᵀ, where
I is the identity matrix. The detectability of the change is the noncentrality of the χ² test, aᵀWᵀ(I + W C Wᵀ)⁻¹W a. If
a is the difference of two suspected jumps, the detectability is twice the Kullback-Leibler divergence between the two
hypotheses (Box & Hill, Technometrics 9, 1967).
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
    """Questions about possible jumps of the errors, which further measurements should answer.

    The noncentrality of a χ² test measures how clearly a measurement would show a shift of the unknowns. `shifts`,
    shape (m, P), contains m possible shifts of the P unknowns z. `weights`, shape (q, m), contains one row for each of
    the q questions: the weights with which the noncentralities of the m shifts are summed.
    """

    shifts: Array
    weights: Array

    @classmethod
    def which_jump(cls, jumps: Array) -> JumpQuestions:
        """Return one question for each pair of the k suspected `jumps`: which jump of the pair has occurred?

        `jumps`, shape (k, P), contains each jump as a change of the P unknowns.
        """
        pairs = np.array(list(combinations(range(len(jumps)), 2)), dtype=np.intp).reshape(-1, 2)
        return cls(jumps[pairs[:, 0]] - jumps[pairs[:, 1]], np.eye(len(pairs)))

    @classmethod
    def any_jump(cls, unknowns: Unknowns) -> JumpQuestions:
        """Return one question for each geometric error: has this error jumped?

        The assumed jumps shift each coefficient of the error by its standard deviation in the family of machines.
        """
        names = np.array([parameter.error for parameter in unknowns.model.parameters])
        moves = np.eye(len(names), unknowns.blocks.size)
        return cls(moves, np.array([names == error for error in ERRORS], dtype=np.float64))

    def noncentralities(self, factors: Array, covariance: Array) -> Array:
        """Return the noncentrality, shape (N, q), that each of N positions contributes to each of the q questions.

        A large noncentrality means that the position answers the question clearly. `factors`, shape (N, r, P), contains
        the information factors of the positions, with r rows each. `covariance`, shape (P, P), is the covariance of the
        unknowns z before these positions are measured.
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
    """Yield the indices of the candidates in the order in which they should be measured.

    The next candidate is always the one with the largest value per minute, assuming that the positions `measured` and
    all candidates yielded earlier have been measured. The value is the increase of the sum of ln(1 + noncentrality)
    over the questions. Questions that are already answered therefore contribute little. `allowed`, shape (N,), marks
    the candidates that may be yielded, each of them once. `minutes`, shape (N,), contains the time that each candidate
    needs.
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
