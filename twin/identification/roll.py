"""Roll of a straight artefact about its line, estimated without linearisation in the roll.

The distances of the balls from the line form a pattern u of a few micrometres in each position. A roll by the angle φ
changes the pattern to u cos φ + (n × u) sin φ, where n is the direction of the line. Its two coefficients are therefore
linear unknowns, valid for every angle and without a start value, and they are projected out of the equations together
with the shift and the two tilts of the position. The estimated coefficients give the roll. The derivatives with respect
to the errors of the certificate depend on the roll, and the pattern depends on these errors: a ball without a
certificate may be farther off the line than all others. So the poses are rolled, the estimated errors are added to the
pattern, and the estimate is repeated (Gauss-Newton iteration for the product of both).

The errors of the machine are estimated in the same equations. This separates a pattern of the artefact, which is the
same in all positions, from the straightness errors of the machine, which are as large.

If the ball centres are known only roughly, the pattern of the artefact file is not that of the artefact, and the rolls
cannot be found with it. The start then comes from the measured patterns alone. The same pattern u, in complex numbers
(two directions across the line), is measured in all positions, each time turned by the roll φ: p = u exp(iφ) + trend.
The trend is the effect of a shift and a tilt of the position, and the errors of the machine are far smaller than u.
Alternating least squares gives u and the rolls. Only a common turn of all rolls stays free. It is chosen so that u
resembles the pattern known beforehand or, if that is zero, so that the rolls of the mount are right on average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import CERTIFIED_MM
from twin.artefact.observations import Observations
from twin.identification.centres import CentreEquations
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.options import Options
from twin.identification.poses import Poses, rotation_matrices
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.scales import Scales
from twin.identification.straight_lines import StraightLines
from twin.machine.machine_population import Family

_CONVERGED_RAD = 1e-7  # the result must not depend on the start
_NO_PATTERN_MM = 1e-9  # balls that stand on an exact line, but for rounding
_MAX_ITERATIONS = 15  # a pattern larger than the errors of the certificate needs five or six
_ROUNDS = 30
_MOUNT_WEIGHT = 1e-3  # of the mount's rolls beside the known pattern: they decide only if that is zero
Complex = np.ndarray[Any, np.dtype[np.complex128]]
Rows = np.ndarray[Any, np.dtype[np.int64]]


def build_measured_problem(
    family: Family, observations: Observations, artefact: Artefact, options: Options
) -> IdentificationProblem:
    """Build the problem of a measured set, in which the roll of straight artefacts is estimated.

    Raise DataError for a ball that the artefact does not have, or for an invalid prior.
    """
    return with_estimated_roll(build_problem(family, observations, artefact, options), options.start_scales)


def restrict_measured_problem(
    whole: IdentificationProblem, accepted: np.ndarray[Any, Any], options: Options
) -> IdentificationProblem:
    """Return the problem with the rows (measured balls) that the mask `accepted` (n,) marks.

    The roll of straight artefacts is estimated again: a single ball that is far off determines it alone.
    """
    return with_estimated_roll(whole.with_rows(accepted), options.start_scales)


def with_estimated_roll(problem: IdentificationProblem, scales: Scales) -> IdentificationProblem:
    """Return the problem at poses with the estimated roll of all straight artefacts.

    The roll at the given poses counts as that of the mount: a weak prior, which decides only if the measurements do not
    see the roll.
    """
    lines = problem.arms.lines
    if lines is None:
        return problem
    rolled, local = np.zeros(problem.layout.positions), problem.local
    pattern_is_measured = False
    if not problem.nuisance.errors.has_certificate:
        known = known_centres(problem)
        pattern_is_measured = known is None
        rolled, local = measured_pattern(problem, lines) if known is None else (rolled, known)
        arms = replace(problem.arms, pattern=local - problem.local)
        problem = replace(problem, arms=arms).with_poses(_rolled(problem, lines, rolled))
    for _ in range(_MAX_ITERATIONS):
        vector, moves, estimated = _roll_vector(problem, lines, local, scales)
        if not pattern_is_measured:
            local = estimated
        # mode of the likelihood of both coefficients times a von Mises prior at the mount's roll; a well-seen pattern
        # (5 standard deviations or more) leaves the prior no weight, so that the start does not matter
        concentration = np.exp(-0.5 * np.linalg.norm(vector, axis=1))
        vector += concentration[:, None] * np.stack((np.cos(rolled), -np.sin(rolled)), axis=1)
        step = np.where(lines.straight, np.arctan2(vector[:, 1], vector[:, 0]), 0.0)
        # The shifts and tilts of the start were fitted at another roll. The design is linearised at the poses, so they
        # must not depend on that start either.
        problem = replace(problem, poses=problem.poses.moved(moves, problem.arms))
        problem = problem.with_poses(_rolled(problem, lines, step))
        rolled += step
        if float(np.abs(step).max()) < _CONVERGED_RAD:
            break
    return problem


def _rolled(problem: IdentificationProblem, lines: StraightLines, rolls: Array) -> Poses:
    """Return the poses turned by angles (K,) in rad about the line through the middle of the balls of each position."""
    poses, middle = problem.poses, problem.arms.middle[:, :, None]
    axis = (poses.rotation @ lines.frame[:, :, :1])[:, :, 0]
    rotation = rotation_matrices(rolls[:, None] * axis) @ poses.rotation
    return Poses(rotation, poses.translation + ((poses.rotation - rotation) @ middle)[:, :, 0])


def _roll_vector(
    problem: IdentificationProblem, lines: StraightLines, local: Array, scales: Scales
) -> tuple[Array, Array, Array]:
    """Return the coefficients (K, 2) of the pattern u and of n × u in each position, divided by their variance, the
    increments (K, 6) that fit shift and tilt of each pose but leave its roll, and the estimated ball centres (n, 3) in
    mm in the artefact's frame. The pattern u is that of the centres `local` (n, 3) of the previous estimate."""
    layout, poses = problem.layout, problem.poses
    pattern, size = _patterns(problem, lines, local)
    jacobian = np.zeros((layout.positions, layout.width, 3, 7))
    jacobian[..., :3] = np.eye(3)
    jacobian[..., 3:5] = problem.arms.rotation_columns(layout, poses, problem.local)[..., 1:]
    jacobian[..., 5:] = pattern
    equations = CentreEquations.without(jacobian, problem, unit_weights=False)
    right, increments = equations.first_right_side()
    precision = PriorPrecision(problem.blocks, problem.known)
    posterior = Posterior.of(equations.matrix, precision, scales)
    z = posterior.solve(right / scales.noise**2 + precision.information_vector)
    # increments with the machine's errors at z, and their covariance from the noise and from z
    back = equations.projector.back
    through = back @ equations.parts.reshape(layout.positions, 7, -1)
    fitted = increments + through @ z
    coefficients, moves = fitted[:, 5:], np.insert(fitted[:, :5], 3, 0.0, axis=1)
    spread = posterior.whiten(through[:, 5:].reshape(-1, len(z)))
    variance = scales.noise**2 * np.einsum("kij,kij->k", back[:, 5:], back[:, 5:])
    variance = 0.5 * (variance + np.einsum("kj,kj->k", *2 * [spread.reshape(layout.positions, -1)]))
    coefficients[:, 0] += size
    # coefficients of u / |u| have the variance v, so those of u itself divided by theirs are |u| / v times as large
    weight = np.divide(size, variance, out=np.zeros_like(size), where=size > 0.0)
    errors = problem.nuisance.displacement(problem.observations.ball, z[problem.blocks.certificate], np.zeros(0))
    return np.asarray(coefficients * weight[:, None]), moves, problem.local + errors


def _patterns(problem: IdentificationProblem, lines: StraightLines, local: Array) -> tuple[Array, Array]:
    """Return u / |u| and n × u / |u| (K, width, 3, 2) of each position with the ball centres `local` (n, 3) in mm, and
    the sizes |u| (K,) in mm."""
    layout, arms = problem.layout, problem.arms
    offset = (layout.pad(local) - arms.middle[:, None, :]) * layout.present[:, :, None]
    inside = offset @ lines.frame  # along the line, and the two distances from it
    lateral = problem.poses.rotation @ lines.frame[:, :, 1:]
    one = np.einsum("kwj,kij->kwi", inside[:, :, 1:], lateral)
    # n × turns the first lateral direction into the second one, and that into minus the first one
    other = np.einsum("kwj,kij->kwi", np.stack((-inside[:, :, 2], inside[:, :, 1]), axis=2), lateral)
    size = np.sqrt(np.einsum("kwi,kwi->k", one, one))
    size[size < _NO_PATTERN_MM] = 0.0
    pattern = np.stack((one, other), axis=3) / np.where(size > 0.0, size, np.inf)[:, None, None, None]
    return pattern, np.where(lines.straight, size, 0.0)


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
