"""Start of the roll of straight artefacts whose balls are known only roughly.

The roll of a straight artefact shows in the pattern of the distances of its balls from their line. If the centres are
known only roughly, the pattern of the artefact file is not that of the artefact, and the rolls cannot be found with it.
The same pattern u, in complex numbers (two directions across the line), is however measured in all positions, each time
turned by the roll φ: p = u exp(iφ) + trend. The trend is the effect of a shift and a tilt of the position, and the
errors of the machine are far smaller than u. Alternating least squares gives u and the rolls. Only a common turn of all
rolls stays free. It is chosen so that u resembles the pattern known beforehand or, if that is zero, so that the rolls
of the mount are right on average.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.certificate import CERTIFIED_MM
from twin.identification.problem import IdentificationProblem
from twin.identification.straight_lines import StraightLines

_ROUNDS = 30
_MOUNT_WEIGHT = 1e-3  # of the mount's rolls beside the known pattern: they decide only if that is zero

Complex = np.ndarray[Any, np.dtype[np.complex128]]
Rows = np.ndarray[Any, np.dtype[np.int64]]


def known_centres(problem: IdentificationProblem) -> Array | None:
    """Return the ball centres (n, 3) in mm that an earlier estimate found; None if the problem carries none over."""
    known = problem.known
    if known is None or not known.information_vector.any():
        return None
    inside, mean = known.members, np.zeros(problem.blocks.size)
    mean[inside] = np.linalg.solve(known.precision[np.ix_(inside, inside)], known.information_vector[inside])
    errors = mean[problem.blocks.certificate]
    return problem.local + problem.nuisance.displacement(problem.observations.ball, errors, np.zeros(0))


def measured_pattern(problem: IdentificationProblem, lines: StraightLines) -> tuple[Array, Array]:
    """Return the rolls (K,) in rad of the positions relative to the poses of `problem`, and the ball centres (n, 3) in
    mm in the artefact's frame, with the pattern that all positions have in common.

    Positions whose artefact is not straight have the roll 0 and keep their centres.
    """
    positions = _positions(problem, lines)
    pattern, turns = _common_pattern(positions, len(problem.nuisance.errors.balls))
    resemblance = sum(np.vdot(pattern[one.balls], one.without_trend(one.known)) for one in positions)
    turn = resemblance / CERTIFIED_MM**2 + _MOUNT_WEIGHT * np.sum(turns)
    turn /= abs(turn)
    rolls, local = np.zeros(problem.layout.positions), problem.local.copy()
    for one, rolled in zip(positions, turns, strict=True):
        rolls[one.number] = np.angle(rolled / turn)
        lateral = one.trend(one.known) + one.without_trend(pattern[one.balls] * turn)
        frame = lines.frame[one.number]
        local[one.rows] = np.column_stack((one.along, lateral.real, lateral.imag)) @ frame.T
    return rolls, local


@dataclass(frozen=True, eq=False)
class _StraightPosition:
    """Balls of one position on a line: their places `along` (m,) it, and their distances from it as complex numbers
    (m,), `known` from the artefact file and `measured`, all in mm. `number` is that of the position, `rows` are its
    rows, and `basis` (m, 2) is an orthonormal basis of shift and tilt."""

    number: int
    rows: Rows
    balls: Rows
    along: Array
    known: Complex
    measured: Complex
    basis: Array

    def trend(self, lateral: Complex) -> Complex:
        return np.asarray(self.basis @ (self.basis.T @ lateral))

    def without_trend(self, lateral: Complex) -> Complex:
        return np.asarray(lateral - self.trend(lateral))


def _positions(problem: IdentificationProblem, lines: StraightLines) -> list[_StraightPosition]:
    layout, poses = problem.layout, problem.poses
    rotations, translations = poses.rotation[layout.index], poses.translation[layout.index]
    found = np.einsum("nji,nj->ni", rotations, problem.touched - translations)
    positions = []
    for number in np.flatnonzero(lines.straight).tolist():
        rows, frame = np.flatnonzero(layout.index == number), lines.frame[number]
        inside, seen = problem.local[rows] @ frame, found[rows] @ frame
        basis = np.linalg.qr(np.column_stack((np.ones(len(rows)), inside[:, 0])))[0]
        known, measured = (one[:, 1] + 1j * one[:, 2] for one in (inside, seen))
        balls = problem.observations.ball[rows]
        positions.append(_StraightPosition(number, rows, balls, inside[:, 0], known, measured, basis))
    return positions


def _common_pattern(positions: list[_StraightPosition], count: int) -> tuple[Complex, Complex]:
    """Return the pattern u (N,) in mm of the N (`count`) balls, and exp(iφ) (k,) of the k straight positions."""
    fullest = max(positions, key=lambda one: len(one.balls))
    pattern = np.zeros(count, dtype=np.complex128)
    pattern[fullest.balls] = fullest.without_trend(fullest.measured)
    turns = np.ones(len(positions), dtype=np.complex128)
    for _ in range(_ROUNDS):
        total, seen = np.zeros(count, dtype=np.complex128), np.zeros(count)
        for k, one in enumerate(positions):
            product = np.vdot(one.without_trend(pattern[one.balls]), one.measured)
            turns[k] = product / abs(product) if product else 1.0
            # the trend of a position is unknown, so that of the pattern stands in its place
            total[one.balls] += one.without_trend(one.measured) / turns[k] + one.trend(pattern[one.balls])
            seen[one.balls] += 1.0
        pattern = np.divide(total, seen, out=pattern.copy(), where=seen > 0.0)
    return pattern, turns
