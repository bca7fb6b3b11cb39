"""Identification of the error model that is used for compensation, from measured ball centres."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError, PositionError, SingularSet
from twin.identification.alternatives import Alternative
from twin.identification.checks.common_scale import CommonScale, common_scale
from twin.identification.checks.mirrored_artefact import refuse_mirrored
from twin.identification.checks.outliers import Rows, WhitenedResiduals, contradicting_rows, studentised_residuals
from twin.identification.checks.shift_pattern import (
    EstimatedShift,
    PatternTest,
    estimated_shifts,
    shift_patterns,
    with_ball_shifts,
)
from twin.identification.checks.slipped_position import Slip, slip_in
from twin.identification.checks.step_in_run import StepInRun, evidence_of_step, step_in_run
from twin.identification.checks.wrong_balls import WrongBallSearch, is_isolated, with_free_balls
from twin.identification.distances import DistanceEquations
from twin.identification.drift_trend import DriftTrend
from twin.identification.estimate import Estimate, Misfit
from twin.identification.evidence import PRIOR
from twin.identification.options import Options
from twin.identification.poses import Poses, rigid_poses
from twin.identification.prior_from_estimate import DriftFactor
from twin.identification.problem import IdentificationProblem
from twin.identification.roll import build_measured_problem, restrict_measured_problem
from twin.identification.scales import OUTSIDE_FAMILY
from twin.identification.solution import Solution, average_over_scales, solve
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel
from twin.machine.machine_population import Family
from twin.thermal.machine_drift import DriftEstimate
from twin.units import UM_PER_MM

_MAX_REJECTED_SHARE = 0.2
_MIN_BALLS = 3
_NOISY = 1.4  # times the stated noise: more than the gate of the fit allows
_SLIP_ABOVE_MISFIT = 4.0  # size of a slip relative to the misfit that the modes leave out

Mask = np.ndarray[Any, np.dtype[np.bool_]]


@dataclass(frozen=True, eq=False)
class AcceptedRows:
    """Result of a search for wrong measurements. `mask` (n,) marks the ball centres that are no outliers. The certified
    centres of the balls `free` contradict the measurements and are left free. `shifts` contains the names of the shifts
    of the balls (module `twin.identification.checks.shift_pattern`) that are further unknowns."""

    mask: Mask
    free: tuple[int, ...] = ()
    shifts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _RowSelection:
    """Accepted rows of the problem `whole`, and the problem that consists of these rows.

    `screened` is the solution of `problem` with which the measurements were checked, with its `residuals`. Both are
    None if the rows were not checked. The certified centres of the balls `free` contradict the measurements and are
    left free. `contradicted` is True if any ball contradicted its certificate in the search for outliers, even if it is
    no longer free.
    """

    whole: IdentificationProblem
    problem: IdentificationProblem
    accepted: Mask
    screened: Solution | None = None
    residuals: WhitenedResiduals | None = None
    free: tuple[int, ...] = ()
    contradicted: bool = False

    @property
    def measured(self) -> Rows:
        """Place of each accepted row in the order of measuring."""
        return np.asarray(self.whole.layout.order[self.accepted])

    @cached_property
    def pattern(self) -> PatternTest | None:
        """Result of the test for a pattern of shifts. It is None if the rows were not checked, or if the machine is so
        far outside its family that they cannot be tested."""
        solution, residuals = self.screened, self.residuals
        if solution is None or residuals is None or _is_strange(solution):
            return None
        return shift_patterns(solution.equations.problem, residuals, self.measured)


def identify(
    model: ErrorModel,
    observations: Observations,
    artefact: Artefact,
    family: Family,
    options: Options | None = None,
) -> Estimate:
    """Estimate the parameters of `model` from ball centres measured on `artefact`.

    `family` is the prior of the parameters. The identification uses its standard deviations as units of the parameters.
    Raise SingularSet if the measurements do not determine the parameters, for example because there are too few
    positions or too few different balls. Raise DataError if the family belongs to a different model, or if a measured
    ball is not on the artefact. Raise PositionError if the artefact moved while a position was measured; the order of
    measuring is that of the rows.
    """
    options = options or Options()
    if family.model != model:
        raise DataError("the family belongs to another model", hint="use the family of the same machine file")
    _check_set(observations)
    whole = build_measured_problem(family, observations, artefact, options)
    return _estimate(_select_rows(whole, family, artefact, options), options)


def accepted_rows(family: Family, observations: Observations, artefact: Artefact, options: Options) -> AcceptedRows:
    """Return the ball centres that `identify` would accept, the balls whose certified centres it would leave free, and
    the shifts that it would estimate."""
    _check_set(observations)
    whole = build_measured_problem(family, observations, artefact, options)
    accepted = np.empty(observations.size, dtype=bool)
    selection = _select_rows(whole, family, artefact, options)
    accepted[whole.layout.order] = selection.accepted
    return AcceptedRows(accepted, selection.free, _names(selection.whole))


def identify_accepted(
    family: Family, observations: Observations, artefact: Artefact, options: Options, accepted: AcceptedRows
) -> Estimate:
    """Identify with exactly the rows, the free balls and the shifts of `accepted`. All other rows count as rejected."""
    whole = build_measured_problem(family, observations, artefact, options)
    whole = with_ball_shifts(whole, accepted.shifts, whole.layout.order)
    chosen = accepted.mask[whole.layout.order]
    problem = whole if chosen.all() else restrict_measured_problem(whole, chosen, options)
    problem = with_free_balls(problem, accepted.free, options)
    return _estimate(_RowSelection(whole, problem, chosen, free=accepted.free), options)


def _check_set(observations: Observations) -> None:
    """Raise SingularSet if the set has too few positions or too few different balls. A prior cannot replace these
    measurements."""
    counts = np.unique(observations.position, return_counts=True)[1]
    useful = int((counts >= 2).sum())
    if useful < 2:
        raise SingularSet(
            f"{len(counts)} position(s), {useful} of them with two balls or more, cannot separate machine errors "
            "from artefact errors",
            hint="measure the artefact in at least two positions, preferably those of S3",
        )
    if len(np.unique(observations.ball)) < _MIN_BALLS:
        raise SingularSet(
            f"fewer than {_MIN_BALLS} different balls were measured",
            hint="use an artefact with more balls or measure more of them",
        )


def _select_rows(whole: IdentificationProblem, family: Family, artefact: Artefact, options: Options) -> _RowSelection:
    if options.outliers == "none":
        return _RowSelection(whole, whole, np.ones(whole.observations.size, dtype=bool))
    selection = _without_outliers(whole, options)
    while name := _shift_to_estimate(selection, options):
        whole = with_ball_shifts(whole, [name], whole.layout.order)
        selection = _without_outliers(whole, options)
    if selection.contradicted:
        seen = whole.observations.select(selection.accepted)
        refuse_mirrored(selection.problem, selection.free, family, seen, artefact, _screening(options))
    return selection


def _shift_to_estimate(selection: _RowSelection, options: Options) -> str:
    """Return the name of a shift that explains the measurements but is no unknown yet; empty if there is none."""
    pattern, known = selection.pattern, _names(selection.whole)
    if pattern is None or pattern.false_alarm >= options.false_alarm or pattern.unknown in known:
        return ""
    return pattern.unknown


def _names(problem: IdentificationProblem) -> tuple[str, ...]:
    return tuple(shift.name for shift in problem.unknowns.shifts)


def _without_outliers(whole: IdentificationProblem, options: Options) -> _RowSelection:
    """Return the rows that remain after outliers have been rejected. Rejection and fit are repeated until no ball
    contradicts the others. These fits always use ball centres and the prior.

    Balls that are wrong in several positions are first tested against their certificate: if it is wrong, their centres
    are left free and their rows stay. In the end, a ball that was freed because of an outlier is bound again.

    If a sudden change of the machine or a pattern of shifts explains more than wrong balls or a slip, nothing more is
    rejected.
    """
    screening = _screening(options)
    accepted = np.ones(whole.observations.size, dtype=bool)
    problem, search = whole, WrongBallSearch(screening)
    while True:
        solution = search.solve(problem)
        residuals = studentised_residuals(solution)
        worst = contradicting_rows(residuals, options.false_alarm)
        if not is_isolated(problem.observations.ball[worst]) and search.found_in(problem, solution):
            continue
        slip = slip_in(worst, residuals, options.false_alarm) if worst.size and _is_plausible(solution) else None
        if worst.size == 0 or _more_is_explained(whole, accepted, solution, residuals, worst, slip):
            _check_plausible(solution)
            if search.bind_again(problem, solution):
                continue
            problem, contradicted = solution.equations.problem, search.contradicted_in(solution)
            return _RowSelection(whole, problem, accepted, solution, residuals, search.free, contradicted)
        if slip is not None and slip.size_mm > _SLIP_ABOVE_MISFIT * _unresolved_rms_mm(whole, solution):
            _report_slip(whole, accepted, slip)
        accepted = accepted.copy()
        accepted[np.flatnonzero(accepted)[worst]] = False
        _check_rejected_share(accepted)
        problem = restrict_measured_problem(whole, accepted, options)
        _check_set(problem.observations)


def _more_is_explained(
    whole: IdentificationProblem,
    accepted: Mask,
    solution: Solution,
    residuals: WhitenedResiduals,
    worst: Rows,
    slip: Slip | None,
) -> bool:
    """Return True if a step of the machine in the run, or a pattern of shifts, explains more than the rejection of the
    rows `worst` and more than the slip of a position."""
    if not _is_plausible(solution):
        return False
    # half a decrease of χ² is a logarithm of a likelihood ratio
    rejected = float(residuals.square[worst].sum()) / residuals.scale
    explained = 0.5 * max(rejected, 0.0 if slip is None else slip.gain)
    problem, measured = solution.equations.problem, whole.layout.order[accepted]
    pattern = shift_patterns(problem, residuals, measured)
    return max(evidence_of_step(problem, residuals, measured), pattern.log_ratio) > explained


def _unresolved_rms_mm(whole: IdentificationProblem, solution: Solution) -> float:
    """Return the rms in mm of errors whose wavelength is too short for the misfit modes. On a machine far outside its
    family they can look like a slip of the artefact."""
    return math.sqrt(3.0 * whole.unknowns.unresolved_mm2(solution.scales))


def _report_slip(whole: IdentificationProblem, accepted: Mask, slip: Slip) -> NoReturn:
    """Raise PositionError, because the artefact moved within a position. Its `row` is that of the first ball after the
    move, in the order of the given observations."""
    seen, rows = whole.observations, np.flatnonzero(accepted)
    before, after = rows[slip.row - 1], rows[slip.row]
    size_um = UM_PER_MM * slip.size_mm
    raise PositionError(
        int(seen.position[after]),
        f"moved between ball {seen.ball[before]} and ball {seen.ball[after]} by about {size_um:.0f} µm",
        hint="measure this position again or remove it",
        row=int(whole.layout.order[after]),
    )


def _check_plausible(solution: Solution) -> None:
    """Raise DataError if only errors a hundred times those of the family would explain the measurements."""
    if not _is_plausible(solution):
        raise DataError(
            f"the ball centres contradict the artefact or the machine: only errors {PRIOR.high:g} times as large as "
            "those of the machine's family would explain them",
            hint="check the artefact file, ball numbers, tool offset and units before measuring again",
        )


def _is_plausible(solution: Solution) -> bool:
    """Return False if the estimated scale of the errors of the machine is at its upper bound. A few gross errors of
    balls may be the cause, until they are rejected."""
    scales = solution.scales
    return not solution.scales_estimated or max(scales.prior, *scales.independent) <= 0.99 * PRIOR.high


def _check_rejected_share(accepted: Mask) -> None:
    rejected = int((~accepted).sum())
    if rejected > _MAX_REJECTED_SHARE * accepted.size:
        raise DataError(
            f"{rejected} of {accepted.size} ball centres contradict the rest",
            hint="check the artefact file, ball numbers, tool offset and units before measuring again",
        )


def _estimate(selection: _RowSelection, options: Options) -> Estimate:
    whole, screened = selection.whole, selection.screened
    if screened is None or options != _screening(options):
        likeliest = solve(selection.problem, options, options.formulation)
    else:
        likeliest = screened
    findings = _findings(selection, likeliest, options)
    solution = average_over_scales(likeliest)
    block, unknowns = whole.blocks.parameters, whole.unknowns
    state = _state(whole, options)
    z, covariance = _in_state(state, solution.z, solution.covariance)
    seen = whole.observations
    dropped = np.flatnonzero(~selection.accepted)
    named = [(int(seen.position[row]), int(seen.ball[row]), int(seen.tool[row])) for row in dropped]
    return Estimate(
        model=unknowns.model,
        formulation=options.formulation,
        parameters=unknowns.parameters(z),
        covariance=unknowns.physical_covariance(covariance[block, block]),
        residuals_mm=_residuals(whole, selection, solution),
        chi2_normalised=solution.chi2,
        degrees_of_freedom=solution.degrees_of_freedom,
        rejected=tuple(named),
        scales=solution.scales,
        tool_offsets=seen.used_tool_offsets,
        misfit=Misfit.of(whole.unknowns, z, covariance, _unresolved_mm2(whole.unknowns, solution)),
        information=_information(solution, block),
        unknowns=replace(unknowns, drift=None, shifts=()),
        z=z,
        z_covariance=covariance,
        alternatives=tuple(
            Alternative(one.scales, *_in_state(state, one.z, one.covariance)) for one in solution.alternatives
        ),
        drift=_drift(whole, solution),
        drift_factor=DriftFactor() if options.carried_over is None else options.carried_over.drift_factor,
        trend=DriftTrend() if options.carried_over is None else options.carried_over.trend,
        free_balls=() if options.weights == "unit" else selection.free,
        step=findings.step,
        pattern=findings.pattern,
        shifts=findings.shifts,
        common_scale=findings.common_scale,
        joined_readings=(
            *(() if options.carried_over is None else options.carried_over.joined_readings),
            *(one.checksum for one in options.instruments),
        ),
    )


def _screening(options: Options) -> Options:
    """Return the options with which the measurements are checked, in whatever formulation they are evaluated."""
    return replace(options, formulation="centres", weights="full", use_prior=True, cut_off=None)


@dataclass(frozen=True)
class _Findings:
    """Results of the tests of the whole set; None if the rows are used unchecked or cannot be tested."""

    step: StepInRun | None = None
    pattern: PatternTest | None = None
    common_scale: CommonScale | None = None
    shifts: tuple[EstimatedShift, ...] = ()


def _findings(selection: _RowSelection, solution: Solution, options: Options) -> _Findings:
    """Test the set for a sudden change of the machine and for a pattern of shifts, and the common scale of the axes
    against the family. An estimate that is carried over contains its own common scale, so there is none to test."""
    if options.outliers == "none":
        return _Findings(shifts=estimated_shifts(solution))
    if selection.screened is None or selection.residuals is None:
        screening = _screening(options)
        if screening != options:
            solution = solve(selection.problem, screening, screening.formulation)
        residuals = studentised_residuals(solution)
        selection = replace(selection, screened=solution, residuals=residuals)
    else:
        solution, residuals = selection.screened, selection.residuals
    scale = common_scale(solution) if options.carried_over is None else None
    shifts = estimated_shifts(solution)
    if selection.pattern is None:
        return _Findings(common_scale=scale, shifts=shifts)
    seen = selection.whole.observations
    tool_offset = seen.tool_offsets[np.bincount(seen.tool).argmax()]
    step = step_in_run(solution, residuals, selection.measured, tool_offset)
    return _Findings(step, selection.pattern, scale, shifts)


def _information(solution: Solution, block: slice) -> Array:
    """Return the information matrix of the ball centres about the unknowns in `block`, in units of their noise, with
    that of the readings of other instruments."""
    matrix, direct = solution.equations.matrix[block, block], solution.precision.direct
    if direct is None:
        return matrix
    rows = solution.scales.noise * direct.rows[:, block]
    return np.asarray(matrix + rows.T @ rows)


def _is_strange(solution: Solution) -> bool:
    """Return True for a machine far outside its family whose errors between the balls are not independent, as the tests
    of the whole set assume: they would be taken for a change or a pattern."""
    return solution.scales.of_machine >= OUTSIDE_FAMILY and solution.scales.noise > _NOISY


def _state(whole: IdentificationProblem, options: Options) -> Array | None:
    """Return the matrix (Q, P) that converts the unknowns at the start to the unknowns in the state that the estimate
    describes. Return None if neither drift nor shifts of the balls are estimated.

    The P unknowns at the start include the drift and the shifts. The Q unknowns of the result do not include them.
    """
    drift, blocks, scale = whole.unknowns.drift, whole.blocks, whole.unknowns.scale
    if blocks.drift.start == blocks.size:
        return None
    # parameters in the state = parameters at the start + drift until then, in units of the prior
    state = np.eye(blocks.drift.start, blocks.size)
    if drift is not None and options.state_regressors is not None:
        indices = list(drift.parameter_indices)
        state[indices, blocks.drift] = (
            drift.change_matrix(options.state_regressors)[: len(indices)] / scale[indices][:, None]
        )
    return state


def _in_state(state: Array | None, z: Array, covariance: Array) -> tuple[Array, Array]:
    if state is None:
        return z, covariance
    return state @ z, state @ covariance @ state.T


def _drift(whole: IdentificationProblem, solution: Solution) -> DriftEstimate | None:
    drift, block = whole.unknowns.drift, whole.blocks.drift
    return None if drift is None else DriftEstimate(drift, solution.z[block], solution.covariance[block, block])


def _unresolved_mm2(unknowns: Unknowns, solution: Solution) -> float:
    """Return the variance in mm² per direction of errors whose wavelength is too short for the misfit modes, averaged
    over the plausible scales."""
    likely = [one.scales for one in solution.alternatives] or [solution.scales]
    return float(np.mean([unknowns.unresolved_mm2(scales) for scales in likely]))


def _residuals(whole: IdentificationProblem, selection: _RowSelection, solution: Solution) -> Array:
    """Return the residuals (n, 3) in mm, in the order of the given observations. The residuals refer to the poses of
    the solution."""
    accepted, poses = selection.accepted, solution.poses
    left, local = solution.sides if accepted.all() else whole.sides(solution.z)
    if isinstance(solution.equations, DistanceEquations):
        poses = rigid_poses(selection.problem.layout, local[accepted], left[accepted])
    if not accepted.all():
        poses = _poses_of_all(poses, whole, accepted)
    residuals = np.empty_like(left)
    residuals[whole.layout.order] = left - poses.to_workpiece(whole.layout, local)
    return residuals


def _poses_of_all(poses: Poses, whole: IdentificationProblem, accepted: Mask) -> Poses:
    """Return the poses of all positions. A position without accepted rows has the pose of a neighbour."""
    position = whole.observations.position
    neighbour = np.searchsorted(np.unique(position[accepted]), np.unique(position))
    neighbour = np.minimum(neighbour, len(poses.rotation) - 1)
    return Poses(poses.rotation[neighbour], poses.translation[neighbour])
