"""Which positions show that an error has jumped, and which of several suspicions it is.

That z has moved by a is seen by a position of factor W as W a, with the touches and what is not known of the machine
as noise, 1 + W C Wᵀ. How clearly is the noncentrality of the χ² test, aᵀWᵀ(1 + W C Wᵀ)⁻¹W a; of the difference of two
suspicions it is twice the divergence between them (Box & Hill, Technometrics 9, 1967).
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
    """`shifts` (m, P) of z; `weights` (q, m): which of them make up each question, their noncentralities added."""

    shifts: Array
    weights: Array

    @classmethod
    def which_jump(cls, jumps: Array) -> JumpQuestions:
        """Which of the `jumps` (k, P) it is: one question for each pair."""
        pairs = np.array(list(combinations(range(len(jumps)), 2)), dtype=np.intp).reshape(-1, 2)
        return cls(jumps[pairs[:, 0]] - jumps[pairs[:, 1]], np.eye(len(pairs)))

    @classmethod
    def any_jump(cls, unknowns: Unknowns) -> JumpQuestions:
        """Whether any error has jumped, each of its coefficients by as much as the family spreads."""
        names = np.array([parameter.error for parameter in unknowns.model.parameters])
        moves = np.eye(len(names), unknowns.blocks.size)
        return cls(moves, np.array([names == error for error in ERRORS], dtype=np.float64))

    def noncentralities(self, factors: Array, covariance: Array) -> Array:
        """(N, q) noncentralities that N positions of `factors` (N, r, P) give, (P, P) what is known of z before."""
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
    """Candidates by falling worth per minute, each given those before it and those `measured`; `allowed` (N,) may be
    chosen, each once. What is answered already counts little: the sum of ln(1 + noncentrality) grows most."""
    left, chosen = allowed.copy(), list(measured)
    told = _answered(candidates, measured, questions)
    while left.any():
        each = questions.noncentralities(candidates.factors, candidates.covariance(chosen))
        worth = (np.log1p(told + each) - np.log1p(told)).sum(axis=1) / minutes
        best = int(np.argmax(np.where(left, worth, -np.inf)))
        yield best
        left[best] = False
        chosen.append(best)
        told = told + each[best]


def _answered(candidates: CandidatePositions, measured: list[int], questions: JumpQuestions) -> Array:
    """(q,) by the positions `measured`, one after the other."""
    told = np.zeros(len(questions.weights))
    for number, index in enumerate(measured):
        before = candidates.covariance(measured[:number])
        told = told + questions.noncentralities(candidates.factors[index : index + 1], before)[0]
    return told
