"""Check measurement that is made in a verification and at the beginning of a nightly run.

The measurement requires that the last accepted compensation table is active. The measured ball centres are compared
with their prediction from the last accepted estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from agent.errors import GateRefused
from agent.execution.engine import Engine
from agent.planning.job import Job
from agent.probing.position import PositionRules
from agent.probing.publish import ActiveCompensation
from agent.probing.run_plan import MeasuredPositions, measure_positions
from agent.results.observations import Correction
from agent.runs.kinds.drift_check import Judge, Judgement
from agent.runs.kinds.night_plan import NightPlan
from agent.runs.reference_state import ReferenceState, active_digest
from twin.artefact.mount_pose_estimate import MountPoseEstimate
from twin.artefact.position_set import Position


def require_table_of(reference: ReferenceState, found: ActiveCompensation) -> None:
    """Raise GateRefused if the active compensation table is not the last accepted one."""
    if active_digest(found.table) != reference.table.crc32:
        raise GateRefused(
            f"bank {found.bank} is active, and it does not hold the table accepted in run {reference.run_id}",
            hint="activate that table again, or run `volcal calibrate`",
        )


def measure(
    engine: Engine,
    plan: NightPlan,
    prefix: str,
    positions: Sequence[Position],
    job: Job,
    rules: PositionRules,
    mount_poses: Mapping[int, MountPoseEstimate] | None = None,
) -> MeasuredPositions:
    """Measure the given positions of a nightly run or a verification. The key of every step begins with `prefix`."""
    return engine.run(measure_positions(plan.order(prefix, positions), job.layout, rules, mount_poses))


def judge_measurement(
    judge: Judge, plan: NightPlan, job: Job, measured: MeasuredPositions, correction: Correction
) -> Judgement:
    """Compare all measured balls, including those of held-out positions (measured, but not used for the estimate), with
    the prediction from the last accepted night, the reference of `judge`."""
    held_out = job.balls_of(measured, held_out=True)
    return judge.judge_balls(plan.station, [*held_out, *job.balls_of(measured, held_out=False)], held_out, correction)
