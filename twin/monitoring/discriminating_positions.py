"""Choice of positions whose measurement best shows if an error has jumped, or which of several errors has jumped.

A position is one place and orientation of the artefact. It is described by its information factor W: WᵀW is the
information (the inverse covariance) that its ball centres give about the unknowns z of the identification. If z changes
by a vector a, the measurement of the position, scaled to unit noise, changes by W a. Touch noise and the covariance C
of z give this measurement the covariance I + W C Wᵀ, where I is the identity matrix. The detectability of the change is
the noncentrality of the χ² test for it, aᵀWᵀ(I + W C Wᵀ)⁻¹W a. If a is the difference of two suspected jumps, the
detectability is twice the Kullback-Leibler divergence between the two hypotheses (Box & Hill, Technometrics 9, 1967).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.design.candidates import CandidatePositions
from twin.identification.jump import ERRORS
from twin.identification.unknowns import Unknowns


@dataclass(frozen=True, eq=False)
class JumpQuestions:
    """Questions to be answered by further measurements, such as: has an error jumped, and which one?

    A jump of an error shifts the P unknowns z of the identification. The noncentrality of a χ² test measures how
    clearly a measurement would show a shift. Each question is expressed as a weighted sum of the noncentralities of
    possible shifts: the larger the sum, the more clearly the measurement answers the question. `shifts`, shape (m, P),
    contains m possible shifts of z. `weights`, shape (q, m), contains the m weights for each of the q questions.
    """

    shifts: Array
    weights: Array

    @classmethod
    def which_jump(cls, jumps: Array) -> JumpQuestions:
        """Return one question for each pair of the k suspected `jumps`: which jump of the pair has occurred?

        `jumps`, shape (k, P), contains each jump as a change of the P unknowns of the identification.
        """
        pairs = np.array(list(combinations(range(len(jumps)), 2)), dtype=np.intp).reshape(-1, 2)
        return cls(jumps[pairs[:, 0]] - jumps[pairs[:, 1]], np.eye(len(pairs)))

    @classmethod
    def any_jump(cls, unknowns: Unknowns) -> JumpQuestions:
        """Return one question for each geometric error: has this error jumped?

        The assumed jumps shift each coefficient of the error by its standard deviation in the family of machines, which
        is the prior of the identification.
        """
        names = np.array([parameter.error for parameter in unknowns.model.parameters])
        moves = np.eye(len(names), unknowns.blocks.size)
        return cls(moves, np.array([names == error for error in ERRORS], dtype=np.float64))

    def noncentralities(self, factors: Array, covariance: Array) -> Array:
        """Return the noncentrality of the χ² test, shape (N, q), that each of N positions contributes to each of q
        questions.

        A position is one place and orientation of the artefact; a large noncentrality means that its measurement
        answers the question clearly. `factors`, shape (N, r, P), contains the information factor W of each position,
        with r rows: WᵀW is the information that the measurement of the position gives about the P unknowns z of the
        identification. `covariance`, shape (P, P), is the covariance of z before these positions are measured.
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
    """Yield the indices of N candidate positions in the order in which they should be measured to answer `questions`.

    A position is one place and orientation of the artefact. For each question, the noncentrality of a χ² test measures
    how clearly the measured positions answer it. The next candidate is always the one that, per minute, most increases
    the sum of ln(1 + noncentrality) over the questions, assuming that the positions with the indices `measured` and all
    candidates yielded earlier have been measured. Questions that are already answered therefore contribute little.
    `allowed`, shape (N,), marks the candidates that may be yielded, each of them once. `minutes`, shape (N,), contains
    the time that the measurement of each candidate takes.
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
