"""Expected volumetric compensated error (VCE) against machine minutes if not every ball is touched three times.

Three touches give the centre of a ball, and the centre is the unit of estimate. Here the touch is the unit: each touch
is one scalar equation, with the pose of the artefact as unknown. The two end balls of a position keep their three
touches, because the pose is found from them. Designs of the shipped case `quick` are compared in equal minutes:

- centres: three touches of each measured ball, of all balls or a share of them.
- one touch, two touches: of each other ball, with directions that alternate from ball to ball.
- chosen touches: at each position those touches that together lower the expected error most per second, given what a
  set in this slot tells beside the position.

The minutes of a position are those of its plan with three touches, less the mean time of a touch with its way from the
touch before for each touch that is left out. Neither the checks that single touches take away nor the touches that a
miss would cost are counted, so the gain is an upper estimate. `python -m benchmarks.single_touches` takes some minutes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.execution.steps import MoveTo, TouchTowards
from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import expected_plan, set_alone, walk_plan
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.variants import BALL_SHARES
from agent.planning.job import Job
from twin.arrays import Array
from twin.artefact.pose_alignment import choose_alignment_balls
from twin.design.candidates import CandidatePositions, joined_candidates
from twin.design.goals import TimeSlotGoal
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch
from twin.errors import DataError
from twin.identification.poses import pose_jacobian
from twin.identification.problem import build_problem
from twin.units import S_PER_MIN

SLOTS_MIN = (6.0, 8.0, 10.0, 12.3, 16.0)
WAYS = ("centres", "one touch", "two touches", "any of these", "any, or chosen touches")
_TOUCH = re.compile(r"(.*/ball-\d+)/touch-(\d+)(.*)")
_FREE_POSE = 0.3  # standard deviation of the pose in mm in the choice of touches: rounding then stays below 1e-4
_ROUNDS = 2  # of chosen touches: the second with the knowledge that a set of the first gives
_RANK_TOLERANCE = 1e-9

Mask = NDArray[np.bool_]


def touch_seconds(job: Job) -> tuple[float, float]:
    """Return the mean times in s of the first touch of a ball and of a further one, each with the way to it. The end
    balls, which are searched, are left out."""
    _, steps = walk_plan(job, expected_plan(set_alone(job)))
    seconds: dict[tuple[str, str], float] = {}
    searched = set[str]()
    for timed in steps:
        found = _TOUCH.match(timed.step.key)
        if found is None or not isinstance(timed.step, (MoveTo, TouchTowards)):
            continue
        ball, touch, part = found.groups()
        seconds[ball, touch] = seconds.get((ball, touch), 0.0) + timed.seconds
        if part == "/back":  # the tip goes back after each touch of a search
            searched.add(ball)
    usual = {touched: value for touched, value in seconds.items() if touched[0] not in searched}
    first = [value for (_, touch), value in usual.items() if touch == "0"]
    return float(np.mean(first)), float(np.mean([value for (_, touch), value in usual.items() if touch != "0"]))


@dataclass(frozen=True, eq=False)
class TouchRows:
    """Touches of all balls within reach of N positions of the artefact.

    `rows` (N, m, P) are the equations of the m touches of each position for the P unknowns, in units of the noise of a
    touch, and `poses` (N, m, 6) their derivatives with respect to the pose. Rows of missing balls are zero. `ball`
    (N, m) and `touch` (m,) are the numbers of ball and touch; the ball is -1 if it is missing. `fixed` (N, m) marks the
    touches of the end balls.
    """

    job: Job
    candidates: CandidatePositions
    rows: Array
    poses: Array
    ball: NDArray[np.intp]
    touch: NDArray[np.intp]
    fixed: Mask

    @classmethod
    def of(cls, problem: DesignProblem) -> TouchRows:
        job, candidates = problem.job, problem.candidates
        planned = problem.procedure.plan(candidates.positions)
        if planned.positions != candidates.positions:
            raise DataError("the candidates are not in the order of their measurement")
        equations = build_problem(job.machine.family, planned.observations, job.artefact, problem.options)
        layout, directions = equations.layout, job.rules.probing.directions
        sigma = np.sqrt(np.trace(job.procedure.covariance_mm2) / 3.0)  # with the share of the qualified radius
        count, width, touches = layout.positions, layout.width, len(directions)
        design = equations.design[..., : candidates.precision.shape[0]]
        jacobian = pose_jacobian(layout, equations.poses, equations.local, equations.arms)
        present = layout.present[:, :, None, None]
        rows = np.einsum("td,kwdp->kwtp", directions, design) * present / sigma
        poses = np.einsum("td,kwdp->kwtp", directions, jacobian) * present / sigma
        balls = np.where(layout.present, layout.pad(planned.observations.ball.astype(float)), -1).astype(np.intp)
        fixed = np.zeros((count, width), dtype=bool)
        for number, position in enumerate(candidates.positions):
            own = [ball for ball in balls[number].tolist() if ball >= 0]
            chosen = choose_alignment_balls(job.layout.nominal(position), own)
            fixed[number] = np.isin(balls[number], [ball for ball in (*chosen.ends, chosen.third) if ball is not None])
        return cls(
            job=job,
            candidates=candidates,
            rows=rows.reshape(count, width * touches, -1),
            poses=poses.reshape(count, width * touches, -1),
            ball=np.repeat(balls, touches, axis=1),
            touch=np.tile(np.arange(touches), width),
            fixed=np.repeat(fixed, touches, axis=1),
        )

    @cached_property
    def present(self) -> Mask:
        return self.ball >= 0

    def alternating(self, per_ball: int) -> Mask:
        """Return the mask (N, m) of the touches if each ball but the end balls has `per_ball` of them."""
        touches = int(self.touch.max()) + 1
        turn = (self.touch + self.ball) % touches
        return self.present & (self.fixed | (turn < per_ball))

    def chosen(self, covariance: Array, form: Array, first_s: float, more_s: float, fixed_s: Array) -> Mask:
        """Return the mask (N, m) of the touches that together lower trace(`form` C) most per second at each position.

        C is the `covariance` (P, P) of what else is known. The touches of the end balls are made in any case. They take
        `fixed_s` (N,) with everything else in the position. The first touch of a further ball takes `first_s` and each
        further one `more_s`.
        """
        asked = self.present & self.fixed
        carried = covariance @ form @ covariance
        for number in range(len(asked)):
            poses = self.poses[number]
            # A pose is free, so the rigid part of a field changes nothing; without it, rounding stays small.
            rows = self.rows[number] - poses @ np.linalg.lstsq(poses, self.rows[number], rcond=None)[0]
            # R = A C A' + B κ² B' + 1 of the touches that are not made, given those that are; G = A C Q C A'
            spread = rows @ covariance @ rows.T + _FREE_POSE**2 * poses @ poses.T + np.eye(len(rows))
            weight = rows @ carried @ rows.T
            made = best = np.flatnonzero(asked[number])
            seconds = float(fixed_s[number])
            inverse = np.linalg.inv(spread[np.ix_(made, made)])
            gain = float(np.vdot(inverse, weight[np.ix_(made, made)]))
            most = gain / seconds
            while True:
                left = np.flatnonzero(self.present[number] & ~np.isin(np.arange(len(rows)), made))
                if not left.size:
                    break
                # a touch t more: the Schur complement s = R_tt - R_tM R_MM⁻¹ R_Mt, with the row v = (-R_MM⁻¹ R_Mt, 1)
                across = inverse @ spread[np.ix_(made, left)]
                schur = spread[left, left] - np.einsum("mt,mt->t", spread[np.ix_(made, left)], across)
                more = (
                    np.einsum("mt,mn,nt->t", across, weight[np.ix_(made, made)], across)
                    - 2.0 * np.einsum("mt,mt->t", across, weight[np.ix_(made, left)])
                    + weight[left, left]
                ) / schur
                beside = np.isin(self.ball[number][left], self.ball[number][made])
                took = np.where(beside, more_s, first_s)
                pick = int(np.argmax(more / took))
                made = np.append(made, left[pick])
                seconds += float(took[pick])
                gain += float(more[pick])
                inverse = np.linalg.inv(spread[np.ix_(made, made)])
                if gain / seconds > most:
                    most, best = gain / seconds, made
            asked[number, best] = True
        return asked

    def candidates_with(self, asked: Mask) -> CandidatePositions:
        """Return the candidates if the touches of the mask `asked` (N, m) are made. Their poses are projected out."""
        factors = []
        for number, mask in enumerate(asked):
            rows, poses = self.rows[number][mask], self.poses[number][mask]
            basis, sizes, _ = np.linalg.svd(poses, full_matrices=False)
            basis = basis[:, sizes > _RANK_TOLERANCE * sizes[0]]
            free = np.linalg.svd(rows - basis @ (basis.T @ rows), full_matrices=False)
            factor = free[1][:, None] * free[2]
            factors.append(np.pad(factor, ((0, asked.shape[1] - len(factor)), (0, 0))))
        used = np.abs(np.array(factors)).max(axis=(0, 2)) > 0.0
        made = self.candidates
        return CandidatePositions(made.positions, made.balls, np.array(factors)[:, used], made.precision, made.form)

    def omitted(self, asked: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the numbers (N,) of the balls without a touch, and of the other touches that are left out."""
        touches = int(self.touch.max()) + 1
        of_ball = (asked & self.present).reshape(len(asked), -1, touches).sum(axis=2)
        there = self.present.reshape(len(asked), -1, touches)[:, :, 0]
        balls = (there & (of_ball == 0)).sum(axis=1)
        return balls, (there * touches - of_ball).sum(axis=1) - touches * balls


@dataclass(frozen=True, eq=False)
class Offer:
    """Candidates with one rule of touches, and their minutes (N,)."""

    candidates: CandidatePositions
    minutes: Array


@dataclass(frozen=True, eq=False)
class TouchDesigns:
    """Designs out of offered candidates in slots of machine time. `problem` checks the positions for collisions."""

    problem: DesignProblem

    def best(self, offers: Sequence[Offer], slot_min: float) -> tuple[float, Array]:
        """Return the expected VCE in µm of the best set of the offered candidates, and the covariance (P, P) of the
        unknowns after it."""
        candidates = joined_candidates([one.candidates for one in offers])
        stations = np.array([position.station for position in candidates.positions])
        costs = MeasuringCosts(np.concatenate([one.minutes for one in offers]), stations)
        search = ExchangeSearch(
            candidates, costs, lambda index: self.problem.passes(replace(candidates.positions[index], balls=None))
        )
        chosen = TimeSlotGoal(slot_min).select(search)
        return candidates.vce(chosen).aligned_um, candidates.covariance(chosen)


def compute(name: str, grid_deg: float, slots_min: Sequence[float] = SLOTS_MIN) -> dict[str, list[float]]:
    """Return the expected VCE in µm in each slot for each way to touch the balls of the shipped case `name`."""
    job = load_case(shipped_case(name).settings)
    problems = [DesignProblem({job.settings.tool: job}, grid_deg, set_alone, share) for share in BALL_SHARES]
    centres = [Offer(one.candidates, one.prices(one.candidates).minutes) for one in problems]
    touches, designs, every = TouchRows.of(problems[0]), TouchDesigns(problems[0]), centres[0].minutes
    per_ball = len(job.rules.probing.directions)
    counts = problems[0].candidates.balls
    first_s, more_s = touch_seconds(job)
    ball_s = first_s + (per_ball - 1) * more_s
    print(f"{name}: {first_s:.2f} s for the first touch of a ball with the way to it, {more_s:.2f} s for a further one")

    def offer(asked: Mask) -> Offer:
        balls, single = touches.omitted(asked)
        return Offer(touches.candidates_with(asked), every - (balls * ball_s + single * more_s) / S_PER_MIN)

    single, double = offer(touches.alternating(1)), offer(touches.alternating(2))
    free = counts - touches.fixed.sum(axis=1) // per_ball
    fixed_s = S_PER_MIN * every - free * ball_s
    form = problems[0].candidates.form.aligned
    found: dict[str, list[float]] = {name: [] for name in WAYS}
    for slot in slots_min:
        vce_um, known = designs.best(centres, slot)
        found["centres"].append(vce_um)
        found["one touch"].append(designs.best([single], slot)[0])
        found["two touches"].append(designs.best([double], slot)[0])
        offers = [*centres, single, double]
        found["any of these"].append(designs.best(offers, slot)[0])
        for _ in range(_ROUNDS):
            offers = [*offers, offer(touches.chosen(known, form, first_s, more_s, fixed_s))]
            vce_um, known = designs.best(offers, slot)
        found["any, or chosen touches"].append(vce_um)
        print(
            f"{slot:5.1f} min: " + ", ".join(f"{way} {values[-1]:.3f} µm" for way, values in found.items()), flush=True
        )
    return found


def minutes_for(vce_um: float, slots_min: Sequence[float], curve_um: Sequence[float]) -> float:
    """Return the minutes in which a falling curve reaches `vce_um`, linear between the slots."""
    return float(np.interp(-vce_um, -np.array(curve_um), slots_min))


def main(arguments: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.single_touches")
    parser.add_argument("--case", default="quick")
    parser.add_argument("--grid-deg", type=float, default=30.0)
    parser.add_argument("--slots", type=float, nargs="+", default=list(SLOTS_MIN), help="in min, rising")
    asked = parser.parse_args(arguments)
    found = compute(asked.case, asked.grid_deg, asked.slots)
    for slot, vce_um in zip(asked.slots[1:-1], found["centres"][1:-1], strict=True):
        for way, curve_um in found.items():
            minutes = minutes_for(vce_um, asked.slots, curve_um)
            print(f"{vce_um:.2f} µm: {way} {minutes:.2f} min ({100.0 * (1.0 - minutes / slot):+.1f} % saved)")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
