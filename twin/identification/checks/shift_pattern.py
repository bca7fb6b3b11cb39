"""Test for shifts of the balls that follow the same pattern in all positions, such as lost motion of an axis.

A single ball that is shifted contradicts the others. A block of balls that is shifted alike in each position does not:
the poses and the errors of the machine take up most of it. The test knows these patterns:

- the balls from one place in the order of measuring on, in each position (an axis that reverses there),
- the balls on one side of the travel of an axis (a reversal, a counterweight or a joint of the rail at this place),
- the direction in which an axis has moved from the ball before, also from one position to the next,
- the bending of the artefact under gravity.

A pattern is a vector field d with one unknown size. With the whitened residuals r of the solution, the noise σ, the
whitened design A with the poses projected out, and the posterior covariance C of the unknowns, the score and the
information of its size are

    s = -dᵀr/σ²,   F = dᵀd/σ² - dᵀA C Aᵀd/σ⁴

with d whitened and the poses projected out. Module `twin.identification.jump` gives the likelihood ratio of the pattern
against none, and the mean over all patterns is tested as in module `twin.identification.checks.step_in_run`.

Two kinds of pattern have a cause that an estimate can take into account: the lost motion of an axis, whose mean over
both directions is the machine that the table corrects, and the bending of the artefact. If such a cause explains the
measurements, its size becomes a further unknown of the identification, and the test is repeated. A shift that is known
only by its place is no such cause: the machine on one side of it differs from that on the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.identification.checks.outliers import Rows, WhitenedResiduals
from twin.identification.jump import jump_evidence, largest_false_alarm, log_mean_ratio
from twin.identification.problem import IdentificationProblem
from twin.identification.solution import Solution
from twin.identification.unknowns import BallShift
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM

_SHARE = 0.95  # probability of all named patterns together
_SHIFT_MM = 0.005  # standard deviation of a shift beforehand
_AS_LIKELY = math.log(3.0)  # largest difference of the evidence of two causes between which the measurements leave open
SAG = "sag"
"""Name of the unknown for what the ends of a bar hang lower than its file states."""
_SPLITS = 9  # places along the travel of an axis at which both sides may differ
_STILL_MM = 0.5  # a shorter motion between two balls has no direction


@dataclass(frozen=True)
class ShiftPattern:
    """Pattern of shifts over all positions, in words. `cause` names the kind of pattern and the axis; patterns that
    differ only in their place have the same cause. `size_um` is the size of the shift, and `probability` that of the
    cause if there is one. `unknown` is the name of the unknown with which an identification takes the shift into
    account; it is empty if there is none."""

    cause: str
    place: str
    size_um: float = 0.0
    probability: float = 1.0
    unknown: str = ""

    @property
    def text(self) -> str:
        return f"{self.cause} by {abs(self.size_um):.1f} µm{self.place}"


@dataclass(frozen=True)
class PatternTest:
    """Result of the test for a pattern. `log_ratio` is the natural logarithm of the mean likelihood ratio of a pattern
    against none. `suspects` are the likeliest causes, the likeliest first. `unknown` is the name of the unknown that
    explains the measurements about as well as any pattern; it is empty if none does."""

    log_ratio: float
    suspects: tuple[ShiftPattern, ...]
    unknown: str = ""

    @property
    def false_alarm(self) -> float:
        """Upper limit of the probability that balls without a pattern give this ratio or a larger one."""
        return largest_false_alarm(self.log_ratio)


@dataclass(frozen=True)
class EstimatedShift:
    """Shift of the balls that was estimated together with the errors of the machine; `name` is that of its unknown."""

    name: str
    size_um: float
    standard_uncertainty_um: float

    @property
    def text(self) -> str:
        size = f"{self.size_um:.1f} µm (standard uncertainty {self.standard_uncertainty_um:.1f} µm)"
        if self.name == SAG:
            return f"sag of the bar beyond the stated one (`sag_um`) {size}"
        return f"{self.name} {size}"


def estimated_shifts(solution: Solution) -> tuple[EstimatedShift, ...]:
    """Return the shifts of the balls that are unknowns of a solution. The uncertainty of a stated sag is one of
    them."""
    blocks, unknowns = solution.equations.problem.blocks, solution.equations.problem.unknowns
    sizes_mm: dict[str, Array] = {}
    doubt_mm = unknowns.artefact.sag.standard_uncertainty_mm
    if doubt_mm:
        sizes_mm[SAG] = np.zeros(blocks.size)
        sizes_mm[SAG][blocks.sag] = doubt_mm
    for column, shift in enumerate(unknowns.shifts, start=blocks.shifts.start):
        sizes_mm.setdefault(shift.name, np.zeros(blocks.size))[column] = shift.size_mm
    return tuple(
        EstimatedShift(
            name,
            UM_PER_MM * float(size_mm @ solution.z),
            UM_PER_MM * math.sqrt(max(float(size_mm @ solution.covariance @ size_mm), 0.0)),
        )
        for name, size_mm in sizes_mm.items()
    )


def shift_patterns(problem: IdentificationProblem, found: WhitenedResiduals, measured: Rows) -> PatternTest:
    """Test for a pattern of shifts in the residuals `found` of a solution of `problem`.

    `measured` (n,) contains the place in the order of measuring of each of the n rows, which are sorted by position.
    """
    patterns, fields, sizes_mm = _patterns(problem, measured)
    unknown = np.array([bool(one.unknown) for one in patterns])
    white = np.einsum("nij,njh->nih", found.whitening, fields * sizes_mm)
    starts = np.cumsum(found.counts) - found.counts
    taken = np.add.reduceat(np.einsum("nip,nih->nph", found.pose_basis, white), starts, axis=0)
    through = white.reshape(-1, len(patterns)).T @ found.unknowns_root.reshape(3 * len(white), -1)
    gram = np.einsum("nih,nih->h", white, white) - np.einsum("kph,kph->h", taken, taken)
    unit = found.variance * found.scale
    information = (gram - np.einsum("hp,hp->h", through, through) / found.variance) / unit
    score = -np.einsum("nih,ni->h", white, found.residuals) / unit
    evidence, size = jump_evidence(score[:, None], np.maximum(information, 0.0)[:, None, None])
    odds = np.exp(evidence - evidence.max())
    shifts_um = UM_PER_MM * sizes_mm * size[:, 0]
    best = int(np.argmax(np.where(unknown, evidence, -np.inf)))
    explaining = patterns[best].unknown if evidence[best] >= evidence.max() - _AS_LIKELY else ""
    return PatternTest(log_mean_ratio(evidence), _ranked(patterns, odds / odds.sum(), shifts_um), explaining)


def with_ball_shifts(problem: IdentificationProblem, names: Sequence[str], measured: Rows) -> IdentificationProblem:
    """Return `problem` with the sizes of the shifts `names` as further unknowns. `measured` is that of
    `shift_patterns`."""
    if not names:
        return problem
    patterns, fields, sizes_mm = _patterns(problem, measured)
    columns = [next(number for number, one in enumerate(patterns) if one.unknown == name) for name in names]
    shifts = [BallShift(name, float(sizes_mm[column])) for name, column in zip(names, columns, strict=True)]
    return problem.with_shifts(shifts, fields[:, :, columns])


def _ranked(patterns: list[ShiftPattern], odds: Array, sizes_um: Array) -> tuple[ShiftPattern, ...]:
    """Return the likeliest causes, each with its likeliest place, the likeliest first."""
    best: dict[str, int] = {}
    total: dict[str, float] = {}
    for number in np.argsort(-odds).tolist():
        cause = patterns[number].cause
        best.setdefault(cause, number)
        total[cause] = total.get(cause, 0.0) + float(odds[number])
    named, share = list[ShiftPattern](), 0.0
    for cause, probability in sorted(total.items(), key=lambda entry: -entry[1]):
        number = best[cause]
        # a sum can exceed 1 by its rounding
        named.append(replace(patterns[number], size_um=float(sizes_um[number]), probability=min(probability, 1.0)))
        share += probability
        if share >= _SHARE:
            break
    return tuple(named)


def _patterns(problem: IdentificationProblem, measured: Rows) -> tuple[list[ShiftPattern], Array, Array]:
    """Return the patterns, their fields (n, 3, H) for a size of 1 mm, and their standard deviations (H,) in mm before
    the measurement."""
    layout, seen = problem.layout, problem.observations
    ends = np.cumsum(layout.counts)
    parts = [start + np.argsort(measured[start:end]) for start, end in zip(ends - layout.counts, ends, strict=True)]
    place, moved, order = np.zeros(seen.size, dtype=np.int64), np.zeros((seen.size, 3)), np.argsort(measured)
    for rows in parts:
        place[rows] = np.arange(len(rows))
    moved[order[1:]] = np.diff(seen.axis_positions[order], axis=0)
    patterns, shares = list[ShiftPattern](), list[tuple[int, Array]]()
    for axis, name in enumerate(AXES):
        for first in range(1, int(place.max()) + 1):
            where = f" from ball {first + 1} of each position on, in the order of measuring"
            patterns.append(ShiftPattern(f"{name} shifted in each position", where))
            shares.append((axis, (place >= first).astype(np.float64)))
        # an axis with lost motion lags behind its display by half of it, in the direction of its motion
        direction = np.where(np.abs(moved[:, axis]) > _STILL_MM, -0.5 * np.sign(moved[:, axis]), 0.0)
        cause = f"{name} differs between both directions of its motion to the ball"
        patterns.append(ShiftPattern(cause, "", unknown=f"lost motion {name}"))
        shares.append((axis, direction))
        for other, (low, high) in enumerate(problem.unknowns.model.ranges_mm):
            for split in np.linspace(low, high, _SPLITS + 2)[1:-1].tolist():
                where = f" where {AXES[other]} is above {split:.0f} mm"
                patterns.append(ShiftPattern(f"{name} shifted on one side of {AXES[other]}", where))
                shares.append((axis, (seen.axis_positions[:, other] > split).astype(np.float64)))
    fields = np.zeros((seen.size, 3, len(patterns)))
    for number, (axis, share) in enumerate(shares):
        fields[:, axis, number] = share
    sizes_mm = np.full(len(patterns), _SHIFT_MM)
    if problem.bending is None:
        return patterns, fields, sizes_mm
    patterns.append(ShiftPattern("the ends of the bar hang lower than its file states", " (`sag_um`)", unknown=SAG))
    # what a larger sag adds to the tool points is subtracted from them in the equations
    fields = np.concatenate((fields, -problem.bending[:, :, None]), axis=2)
    return patterns, fields, np.append(sizes_mm, problem.sag_size_mm)
