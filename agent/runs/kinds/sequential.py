"""Plan of a sequential calibration: each position is chosen from what was measured before it.

After each position the posterior of the machine is renewed, and the position with the largest gain per second is
measured next. The measurement ends when the upper 95 % limit of the predicted volumetric compensated error (VCE) is
below the target, or when only the time of the proof is left. Held-out positions, table and proof are those of any
calibration.

The preflight walks the positions that would be measured if the machine were as its family states, up to the end of the
slot; its machine time is therefore the upper limit of the run. A position that is chosen otherwise is proved from where
the machine stands before anything moves, together with the way to the held-out positions and the proof after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from agent.errors import GateRefused, MeasurementFault, PlanRefused
from agent.execution.steps import ComputeOnce, Fork, Plan, Point, ProvePlan, ReadClock, Record, RunPlan, known
from agent.files import translated
from agent.planning.design.sequential_candidates import (
    MIN_POSITIONS,
    SequentialCandidates,
    held_out_and_proof,
    held_out_order,
    standing_in,
)
from agent.planning.job import Job
from agent.planning.measuring_order import AT_REST_DEG
from agent.planning.preflight import NOTHING_MEASURED, Standing, run_preflight
from agent.probing.measured_balls import Correction, observations_of
from agent.probing.repeated_positions import (
    RepeatRules,
    change_of_machine_k,
    join_measured,
    positions_to_repeat,
    repeat_if_changed,
)
from agent.probing.run_plan import (
    MeasuredPositions,
    MeasuringOrder,
    measure_positions,
    position_key,
    positions_in,
)
from agent.results.estimation import EstimationResult, estimate_from_balls
from agent.results.observations import balls_for_estimate
from agent.runs.kinds.calibration import CalibrationTask, concluded, nothing_more
from agent.runs.kinds.run_parts import PreparedRun, found_compensation, prepared_run, refused
from agent.runs.kinds.slot import AvailableTime
from agent.thermal.machine_drift import is_drifting
from drivers.roles import StoreLimits
from twin.artefact.position_set import Position
from twin.design.sequential import PositionsSeen
from twin.units import MM_PER_UM, S_PER_MIN, UM_PER_MM

STOP = "stop"
SET_NAME = "sequential"
"""Name of a position set that was chosen during the run."""
MAX_PROOFS = 4
"""Number of positions that may be refused for one choice. The measurement then ends."""

_REFUSED = -1.0  # minutes of a plan that cannot be carried out


@dataclass(frozen=True)
class SequentialEnd:
    """End of the measurement: the target of the upper 95 % limit of the predicted VCE in µm, which is None if there is
    none, and the available machine time."""

    target_um: float | None
    time: AvailableTime


@dataclass(frozen=True, eq=False)
class SequentialTask:
    """Task of a sequential calibration. `planned` contains the positions that the preflight walks."""

    calibration: CalibrationTask
    candidates: SequentialCandidates
    end: SequentialEnd
    planned: tuple[Position, ...]

    @property
    def job(self) -> Job:
        return self.calibration.job


@dataclass
class _Renewal:
    """Renewal of the posterior of the machine after each position. It is used on the machine only.

    A resumed run has the results of the former choices from its journal. Its first choice of its own adds all measured
    positions in their order, which gives the same posterior as before the interruption.
    """

    candidates: SequentialCandidates
    correction: Correction
    store: StoreLimits
    seen: PositionsSeen | None = field(default=None, init=False)

    def choice(self, measured: MeasuredPositions, standing: Standing | None, target_um: float | None) -> dict[str, Any]:
        """Return the record of the choice after the `measured` positions, with the artefact at `standing`."""
        seen = self._after(measured)
        estimation = self._estimation(measured, seen, target_um)
        if estimation is not None:
            seen = seen.with_estimate(estimation.estimate)
        done = positions_in(measured)
        ranked = self.candidates.ranked(seen, standing, done)
        limits = None if estimation is None else estimation.volumetric.after_aligned.limits_um
        return {
            "positions": len(done),
            "expected_vce_um": UM_PER_MM * seen.expected_vce_mm,
            "limits_um": None if limits is None else list(limits),
            "order": seen.model.order,
            "scales": list(seen.scales.values),
            "reached": limits is not None and target_um is not None and limits[1] < target_um,
            "ranked": [position_key(position) for position in ranked],
        }

    def _after(self, measured: MeasuredPositions) -> PositionsSeen:
        """Return the posterior after all `measured` positions; those that are new are added one by one."""
        job, seen = self.candidates.job, self.seen or self.candidates.nothing_seen()
        for position in measured.positions[seen.count :]:
            balls = job.balls_of(replace(measured, positions=(position,)), held_out=False)
            seen = seen.after(observations_of(balls, job.tool_offset_mm, self.correction))
        self.seen = seen
        return seen

    def _estimation(
        self, measured: MeasuredPositions, seen: PositionsSeen, target_um: float | None
    ) -> EstimationResult | None:
        """Return the whole identification, if the target may be reached or if the machine drifts; otherwise None.

        The end of a run is judged by the figure that the run will state.
        """
        job = self.candidates.job
        if seen.count < MIN_POSITIONS:
            return None
        balls = balls_for_estimate(job, measured)
        near = target_um is not None and seen.is_near(MM_PER_UM * target_um)
        if not near and not is_drifting(job.settings.temperature, [ball.conditions for ball in balls]):
            return None
        with translated(MeasurementFault):
            estimation = estimate_from_balls(job, balls, self.correction)
        return estimation.applied_by(self.store, job.tool_offset_mm)


@dataclass(frozen=True, eq=False)
class _Running:
    """Sequential calibration in progress: the prepared run, the machine time in s at which it began, and the posterior
    that is renewed."""

    task: SequentialTask
    ready: PreparedRun
    began_s: float
    renewal: _Renewal

    @property
    def job(self) -> Job:
        return self.task.job

    def standing(self, measured: MeasuredPositions) -> Standing | None:
        """Return the place of the artefact after the `measured` positions or, before the first one, after the checks of
        the probe; None if its station is not known."""
        datum = self.ready.prepared.datum
        if measured.positions and positions_in(measured)[-1].station == measured.standing_at:
            return standing_in(positions_in(measured)[-1])
        if measured.positions and measured.standing_at is not None:  # the position for which it was moved was left out
            return Standing(measured.standing_at, *AT_REST_DEG)
        if datum is not None:
            return standing_in(datum.position)
        return None if measured.standing_at is None else Standing(measured.standing_at, *AT_REST_DEG)


def sequential_calibration(task: SequentialTask) -> RunPlan:
    """Return the plan of a whole sequential calibration."""
    began_s: float = yield ReadClock("sequential/begins")
    found = yield from found_compensation()
    ready = yield from prepared_run(task.job, found)
    running = _Running(task, ready, began_s, _Renewal(task.candidates, ready.correction, task.calibration.store))
    nothing = replace(NOTHING_MEASURED, standing_at=ready.prepared.standing_at)
    return (yield from _next(running, nothing))


def _next(running: _Running, measured: MeasuredPositions) -> RunPlan:
    """Renew the posterior, and choose the next position or the end of the measurement."""
    number, end = len(measured.positions), running.task.end
    record = yield ComputeOnce(
        f"sequential/posterior-{number}",
        lambda: running.renewal.choice(measured, running.standing(measured), end.target_um),
    )
    return (yield from _chosen(running, measured, record, ()))


def _chosen(
    running: _Running, measured: MeasuredPositions, record: Mapping[str, Any], left_out: tuple[Position, ...]
) -> RunPlan:
    """Decide between the best position that still fits into the slot and the end of the measurement. Positions in
    `left_out` are not offered."""
    number, task = len(measured.positions), running.task
    key = f"sequential/choice-{_attempt(measured, left_out)}"
    now_s: float = yield ReadClock(f"{key}/clock")
    left = task.end.time.left((now_s - running.began_s) / S_PER_MIN)
    without = {*positions_in(measured), *left_out}
    offered = {position_key(one): one for one in task.candidates.positions if one not in without}
    offered = {name: one for name, one in offered.items() if name not in measured.left_out}
    ways: dict[str, Callable[[], RunPlan]] = {
        name: partial(_proved, running, measured, record, left_out, position, left)
        for name, position in offered.items()
    }
    ways[STOP] = partial(_stopped, running, measured, record)
    planned = position_key(task.planned[number]) if number < len(task.planned) and not left_out else STOP
    # beforehand, the end is walked where it can first come and where the slot is over
    walked = (planned, STOP) if number == MIN_POSITIONS and planned != STOP else (planned,)

    def choose() -> str:
        if record["reached"] or len(left_out) >= MAX_PROOFS:
            return STOP
        seconds = dict(zip(task.candidates.positions, task.candidates.seconds(running.standing(measured)), strict=True))
        for name in map(str, record["ranked"]):
            position = offered.get(name)
            if position is None:
                continue
            if seconds[position] / S_PER_MIN + task.candidates.tail_minutes(position.station) <= left:
                return name
        return STOP

    return Fork(key, choose, ways, expected=planned, walked=walked)


def _proved(
    running: _Running,
    measured: MeasuredPositions,
    record: Mapping[str, Any],
    left_out: tuple[Position, ...],
    position: Position,
    left: float,
) -> RunPlan:
    """Prove the way to the chosen position and from there to the end of the run, and measure the position. If the plan
    is refused or does not fit into the slot, the next best position is chosen."""
    number, job, attempt = len(measured.positions), running.job, _attempt(measured, left_out)
    key = f"sequential/proof-{attempt}"
    proof = _Proof(job, (position,), measured.standing_at, running.standing(measured))
    if not (yield from _fits(key, position_key(position), proof, left)):
        return (yield from _chosen(running, measured, record, (*left_out, position)))
    order = MeasuringOrder(f"measure-{attempt}", (position,), measured.standing_at, first_number=number)
    more = yield from measure_positions(
        order, job.layout, running.ready.rules, measured.mount_poses, measured.last_conditions
    )
    joined = join_measured(measured, more)
    if not more.positions:  # too few balls are within reach, because the mount stands elsewhere than expected
        return (yield from _chosen(running, joined, record, (*left_out, position)))
    return (yield from _next(running, joined))


def _attempt(measured: MeasuredPositions, left_out: tuple[Position, ...]) -> str:
    """Return the number of the next position, with the number of positions that were left out before it if there are
    any, as part of the keys of its steps."""
    return f"{len(measured.positions)}" + (f"-{len(left_out)}" if left_out else "")


def _fits(key: str, name: str, proof: _Proof, left: float) -> Plan[bool]:
    """Carry out `proof`. Return True if its plan can be carried out in the `left` minutes; otherwise, journal that the
    positions with the name `name` are left out."""
    minutes: float = yield ProvePlan(key, proof.minutes)
    if 0.0 <= minutes <= left:
        return True
    reason = "cannot be measured from here" if minutes < 0.0 else f"would take {minutes:.1f} min with the proof"
    yield Record(f"{key}/refused", "event", {"note": f"left out: {name} {reason}"})
    return False


@dataclass(frozen=True, eq=False)
class _Proof:
    """Proof that `positions` can be measured from where the machine stands, and the run be ended after them. The
    artefact stands at the station `standing_at`, with the mount as in `standing`. `held_out_follows` is False if the
    held-out positions have been measured already, so that only the proof of the table follows."""

    job: Job
    positions: tuple[Position, ...]
    standing_at: int | None
    standing: Standing | None
    held_out_follows: bool = True

    def minutes(self, at_mm: Point, watch: Callable[[], None]) -> float:
        """Return the machine minutes from the axis positions `at_mm` to the end of a run that measures only the
        positions before those that follow; negative if the preflight refuses this plan."""
        try:
            return run_preflight(self.job, self._plan, at_mm, watch, standing=self.standing).machine_minutes
        except PlanRefused:
            return _REFUSED

    def _plan(self, job: Job) -> RunPlan:
        order = MeasuringOrder("measure", self.positions, self.standing_at)
        more = yield from measure_positions(order, job.layout, job.rules)
        if self.held_out_follows:
            yield from held_out_and_proof(job, more.standing_at)
        else:
            yield from measure_positions(job.verification_order(more.standing_at), job.layout, job.rules)
        return None


def _stopped(running: _Running, measured: MeasuredPositions, record: Mapping[str, Any]) -> RunPlan:
    """Measure the held-out positions, and write and prove a table from what was measured. The run is refused if nothing
    was measured: there is no estimate without a position, and the way to the held-out positions is not proved."""
    task, ready, number = running.task, running.ready, len(measured.positions)
    if number == 0:
        return (yield from refused(_refuse_nothing_measured))
    yield Record("sequential/end", "event", {"note": _end_text(number, record, task.end)})
    own = with_positions(task.job, positions_in(measured))
    yield known("sequential/job", own)
    order = held_out_order(own, measured.standing_at, number)
    held_out = yield from measure_positions(
        order, own.layout, ready.rules, measured.mount_poses, measured.last_conditions
    )
    both = join_measured(measured, held_out)
    own_task, own_ready = replace(task.calibration, job=own), replace(ready, job=own)
    repeats = replace(own.repeat_rules, closing=())
    if not (yield from _repeats_proved(replace(running, ready=own_ready), both, repeats)):
        repeats = replace(repeats, count=0)
    return (
        yield from repeat_if_changed(
            "sequential",
            both,
            own.layout,
            ready.rules,
            repeats,
            lambda everything: concluded(own_task, own_ready, everything, nothing_more),
        )
    )


def _repeats_proved(running: _Running, measured: MeasuredPositions, repeats: RepeatRules) -> Plan[bool]:
    """Return False if positions were to be measured again because the machine has changed, but cannot be. Which
    positions these are is known only after the measurement, so the way to them is proved here. Their time is not part
    of the slot."""
    again = positions_to_repeat(measured, repeats)
    if not again or change_of_machine_k(measured, repeats) < repeats.threshold_k:
        return True
    standing = running.standing(measured)
    proof = _Proof(running.ready.job, again, measured.standing_at, standing, held_out_follows=False)
    return (yield from _fits("sequential/proof-repeat", "the repetition of the first positions", proof, math.inf))


def _refuse_nothing_measured() -> None:
    raise GateRefused(
        "no position was measured: none could be measured from where the machine stands, with the proof after it, in "
        "the time that was left of the slot",
        hint="nothing was written; give a longer slot, or look at the reasons in `volcal report`",
    )


def _end_text(number: int, record: Mapping[str, Any], end: SequentialEnd) -> str:
    """Return the reason why the measurement ends after `number` positions, from the record of the last choice."""
    if record.get("reached"):
        upper = record["limits_um"][1]
        return f"{number} positions: the upper limit of the VCE, {upper:.2f} µm, is below {end.target_um:g} µm"
    return f"{number} positions: only the time of the held-out positions and of the proof is left"


def with_positions(job: Job, positions: tuple[Position, ...]) -> Job:
    """Return `job` with the `positions` that a sequential calibration has chosen, instead of the position set of the
    settings. The held-out positions stay."""
    procedure = job.settings.procedure.model_copy(update={"position_set": SET_NAME})
    return replace(job, positions=positions, settings=job.settings.model_copy(update={"procedure": procedure}))
