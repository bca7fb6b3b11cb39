"""Trial of one random plan: a preflight, a run on a machine with errors, and a second run that is
interrupted.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

from agent.errors import GateRefused, PlanRefused
from agent.execution.device_assembly import Devices
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from benchmarks.places import memory_directory
from campaigns.nights.play import build_rig
from campaigns.plans.collision_check import CollisionJudge, JudgeResult
from campaigns.plans.motion_run import AlarmClock, CalibrationWithoutIdentification
from campaigns.plans.random_cases import DrawnCase, draw
from campaigns.plans.steps_comparison import walked_branch
from drivers.errors import UserError, VolcalError
from simulators.world.world import World

HOLD_S = 3.0
POSITION_TOLERANCE_MM = 0.01
REGULAR_ENDS = (RunState.COMPLETE, RunState.REFUSED)


@dataclass
class PlanTrial:
    """Result of the trial of one plan.

    `spindle` is the direction of the stylus, such as `-Z`; it is empty if the agent refused the files of the case.
    `refused` is the reason if the agent refused the plan before any motion. `stopped` is the reason if the first run
    moved but ended with an error. `branch` names the branch of the plan that the runs follow. `failures` lists the
    violated conditions. `seen` is the result of the independent collision check, or None if the plan was not checked.
    """

    seed: int
    spindle: str = ""
    refused: str = ""
    stopped: str = ""
    branch: str = ""
    failures: list[str] = field(default_factory=list)
    commands: int = 0
    machine_minutes: float = 0.0
    wall_seconds: float = 0.0
    interruption: str = ""
    seen: JudgeResult | None = None


def try_plan(seed: int, *, judged: bool = False) -> PlanTrial:
    """Carry out the preflight and both runs, one undisturbed and one interrupted, of the random
    plan that `seed` gives, and return the result.

    The function never raises an exception: a refusal is a regular result, and a defect is recorded as a failure.
    """
    trial, began = PlanTrial(seed), perf_counter()
    with memory_directory("plan") as directory:
        try:
            drawn = draw(seed, Path(directory))
            trial.spindle = drawn.spindle.name
            kind = CalibrationWithoutIdentification(seed)
            _run(trial, drawn, kind, judged)
            if not (trial.refused or trial.stopped):
                _interrupted(trial, drawn, kind)
        except (UserError, PlanRefused) as refusal:
            trial.refused = reason_of(refusal)
        except Exception as defect:  # noqa: BLE001  a defect of one plan must not hide the others
            trial.failures.append(f"defect: {defect!r}")
    trial.wall_seconds = perf_counter() - began
    return trial


def _run(trial: PlanTrial, drawn: DrawnCase, kind: CalibrationWithoutIdentification, judged: bool) -> None:
    world, clock = World(drawn.scenario), AlarmClock()
    judge = CollisionJudge(world, drawn.job) if judged else None
    clock.watch = judge.watch if judge else None
    ended = _carry_out(drawn, kind, world, clock, lambda _: None)
    if isinstance(ended.error, (PlanRefused, UserError)):
        trial.refused = reason_of(ended.error)
        return
    if kind.preflight is not None:
        trial.commands, trial.machine_minutes = len(kind.branch.keys), kind.branch.machine_minutes
        trial.branch = kind.branch.name
    if ended.error is not None and not isinstance(ended.error, GateRefused):
        trial.stopped = reason_of(ended.error)
    _judge_world(trial, "run", world)
    _judge_steps(trial, "run", drawn, kind, ended)
    if judge is not None:
        trial.seen = judge.seen()
        trial.failures += [f"run, judged: {text}" for text in trial.seen.collisions]


def _interrupted(trial: PlanTrial, drawn: DrawnCase, kind: CalibrationWithoutIdentification) -> None:
    """Run the plan again and interrupt it; the withdrawal must end at the retreat plane."""
    world, clock = World(drawn.scenario), AlarmClock()
    instant_s = drawn.at_share * kind.branch.machine_seconds
    trial.interruption = drawn.interruption

    def prepare(supervisor: Supervisor) -> None:
        if drawn.interruption == "abort":
            clock.at(instant_s, lambda: supervisor.request_abort("random instant"))
        elif drawn.interruption == "hold":
            clock.at(instant_s, supervisor.request_hold)
            clock.at(instant_s + HOLD_S, supervisor.request_resume)
        else:
            clock.at(instant_s, lambda: world.controller.fail("emergency stop"))

    ended = _carry_out(drawn, kind, world, clock, prepare)
    _judge_world(trial, drawn.interruption, world)
    _judge_steps(trial, drawn.interruption, drawn, kind, ended)
    state = ended.outcome.state
    expected = {"abort": (RunState.ABORTED,), "hold": (), "fault": (RunState.FAULTED,)}
    if state not in (*expected[drawn.interruption], *REGULAR_ENDS):
        trial.failures.append(f"{drawn.interruption}: ended {state.value}: {ended.error}")
    limits, axis = world.controller.limits(), drawn.spindle.axis
    plane_mm = (limits.lower_mm if drawn.spindle.sign > 0 else limits.upper_mm)[axis]
    retreated = abs(float(world.controller.displayed_position()[axis]) - plane_mm)
    if drawn.interruption == "abort" and retreated > POSITION_TOLERANCE_MM:
        trial.failures.append(f"abort: the axes stand {retreated:.1f} mm short of the retreat plane")


def _judge_world(trial: PlanTrial, what: str, world: World) -> None:
    world.advance_to(world.now + 60.0)
    for collision in world.collisions:
        trial.failures.append(f"{what}: {collision.body_a} with {collision.body_b} at {collision.time_s:.2f} s")
    if world.controller.motion.value not in ("idle", "fault"):
        trial.failures.append(f"{what}: left {world.controller.motion.value}")


def _judge_steps(
    trial: PlanTrial, what: str, drawn: DrawnCase, kind: CalibrationWithoutIdentification, ended: RunResult
) -> None:
    """Compare the journaled steps of a run that reached its end with the branch that it had to follow."""
    if kind.preflight is None or ended.outcome.state not in REGULAR_ENDS:
        return
    with open_journal(drawn.job.settings.state_directory) as reader:
        run = reader.require_run(ended.outcome.run_id).run
        keys = [step.key for step in reader.steps(run, procedure_only=True)]
    walked = walked_branch(keys, [kind.branch])
    if isinstance(walked, str):
        trial.failures.append(f"{what}: the preflight did not walk {walked} ({kind.branch.name})")


def _carry_out(
    drawn: DrawnCase,
    kind: CalibrationWithoutIdentification,
    world: World,
    clock: AlarmClock,
    prepare: Callable[[Supervisor], None],
) -> RunResult:
    devices = Devices(lambda _, watched, __: build_rig(world, watched, drawn.job), lambda _: clock)
    hooks = RunHooks(attach=prepare, devices=devices, write_files=False, answers=kind.answers)
    return carry_out(drawn.job, kind, Path("/"), hooks)


def reason_of(error: VolcalError) -> str:
    """Return the type and the message of a refusal (an error), with every number in the message replaced by ``#``.

    Refusals that differ only in their numbers are then counted as the same.
    """
    words = re.sub(r"-?\d+(\.\d+)?", "#", error.message)
    return f"{type(error).__name__}: {words}"


def summarise(trials: Sequence[PlanTrial]) -> dict[str, object]:
    accepted = [trial for trial in trials if not trial.refused]
    seen = [trial.seen for trial in trials if trial.seen is not None]
    return {
        "plans": len(trials),
        "accepted": len(accepted),
        "accepted_by_spindle": dict(sorted(Counter(trial.spindle for trial in accepted).items())),
        "refused": dict(Counter(trial.refused for trial in trials if trial.refused).most_common()),
        "stopped": dict(Counter(trial.stopped for trial in accepted if trial.stopped).most_common()),
        "completed": sum(not trial.stopped for trial in accepted),
        "branches": dict(sorted(Counter(trial.branch for trial in accepted).items())),
        "interrupted": dict(Counter(trial.interruption for trial in accepted if trial.interruption)),
        "failed_seeds": [trial.seed for trial in trials if trial.failures],
        "judged": len(seen),
        "judged_collisions": sum(len(one.collisions) for one in seen),
        "smallest_clearance_mm": round(min((one.smallest_mm for one in seen), default=float("inf")), 3)
        if seen
        else None,
        "commands": sum(trial.commands for trial in trials),
        "machine_hours": round(sum(trial.machine_minutes for trial in trials) / 60.0, 1),
    }
