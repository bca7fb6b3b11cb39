"""Search for balls whose certified centres are wrong, during the rejection of outliers.

A ball with a wrong certified centre contradicts all other balls in every position. Without this search, its rows would
be rejected as outliers one after the other, or the errors of the machine would be scaled up to explain it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.identification.checks.certificate_check import (
    agreeing_balls,
    max_free_balls,
    prior_with_free_balls,
    worst_ball,
)
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem
from twin.identification.roll import with_estimated_roll
from twin.identification.scales import Scales
from twin.identification.solution import Solution, log_evidence_and_scales, solve


def with_free_balls(problem: IdentificationProblem, balls: Sequence[int], options: Options) -> IdentificationProblem:
    """Return the problem in which the certified centres of `balls` are left free.

    The roll of straight artefacts is estimated again: a wrong centre far off the line determines it alone.
    """
    if not balls:
        return problem
    freed = replace(problem, known=prior_with_free_balls(problem.unknowns, problem.known, balls))
    return with_estimated_roll(freed, options.start_scales)


def is_isolated(balls: np.ndarray[Any, np.dtype[np.int64]]) -> bool:
    """Return True if the outliers found are of different balls `balls` (k,). Such outliers are rejected before any ball
    is tested, since a gross one distorts the test."""
    return balls.size > 0 and len(np.unique(balls)) == balls.size


@dataclass
class WrongBallSearch:
    """Search of one rejection of outliers. `free` contains the balls whose centres are left free so far; a ball in
    `bound` was freed in vain and is not freed again. `_last` is the solution that was computed last, with its problem
    and its free balls."""

    options: Options
    free: tuple[int, ...] = ()
    bound: tuple[int, ...] = ()
    _last: tuple[IdentificationProblem, tuple[int, ...], Solution] | None = None

    def solve(self, problem: IdentificationProblem) -> Solution:
        return self._solve(problem, self.free)

    def _solve(self, problem: IdentificationProblem, free: tuple[int, ...]) -> Solution:
        if self._last is None or self._last[0] is not problem or self._last[1] != free:
            found = solve(with_free_balls(problem, free, self.options), self.options, "centres")
            self._last = problem, free, found
        return self._last[2]

    def found_in(self, problem: IdentificationProblem, solution: Solution) -> bool:
        """Free the ball that contradicts its certificate most in `solution`. Return False if there is none.

        A carried-over certificate is not searched, since its errors are already known.
        """
        known, unknowns = problem.known, problem.unknowns
        carried = known is not None and bool(known.members[problem.blocks.certificate].any())
        if carried or len(self.free) >= max_free_balls(unknowns):
            return False
        wrong = worst_ball(unknowns, solution.z, solution.covariance, self.free)
        if wrong is None or wrong in self.bound:
            return False
        free = (*self.free, wrong)
        trial = self._solve(problem, free)
        if worst_ball(unknowns, trial.z, trial.covariance, free) is not None:
            # a gross error distorts the scales and with them the test, but not the evidence
            free = (*self.free, self._likeliest(problem, wrong, trial.scales))
        self.free = free
        return True

    def contradicted_in(self, solution: Solution) -> bool:
        """Return True if a ball contradicted its certificate in the search, or does so in `solution`, which is its
        last one."""
        if self.free or self.bound:
            return True
        unknowns = solution.equations.problem.unknowns
        return worst_ball(unknowns, solution.z, solution.covariance, self.free) is not None

    def bind_again(self, problem: IdentificationProblem, solution: Solution) -> bool:
        """Bind the freed balls that agree with their certificate in `solution`. Return False if there are none."""
        agreeing = agreeing_balls(problem.unknowns, solution.z, solution.covariance, self.free)
        self.bound = (*self.bound, *agreeing)
        self.free = tuple(ball for ball in self.free if ball not in agreeing)
        return bool(agreeing)

    def _likeliest(self, problem: IdentificationProblem, wrong: int, scales: Scales) -> int:
        """Return the certified ball whose centre, if it is left free as well, gives the largest evidence; `wrong` if
        there is no ball to compare. The estimation of the scales starts with `scales`, those of a similar problem."""

        def evidence(ball: int) -> float:
            freed = with_free_balls(problem, (*self.free, ball), self.options)
            return log_evidence_and_scales(freed, self.options, scales)[0]

        artefact = problem.unknowns.artefact
        closed = (*self.free, *self.bound, *artefact.uncertified)
        candidates = (ball for ball in range(len(artefact.balls)) if ball not in closed)
        return max(candidates, key=evidence, default=wrong)
