"""Preflight, which executes the complete plan of a run on a simulated machine before the real machine moves.

The simulation runs in virtual time. The simulated machine moves like the real machine, and the time model of the run
(`agent.planning.time_model`) adds the latencies of the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from agent.errors import Aborted, Interrupted, MeasurementFault, PlanRefused
from agent.execution.engine import Engine
from agent.execution.steps import Plan, Point, Step
from agent.planning.cycle_time import TimedStep
from agent.planning.job import Job
from agent.planning.preflight_rig import assemble_preflight_rig
from agent.planning.safety_rules import checked_plan
from agent.planning.time_model import TimeModel, time_model
from agent.probing.repeated_positions import measure_with_repeats
from agent.probing.run_plan import MeasuredPositions, measure_positions, position_key
from drivers.clock import VirtualClock, wall_seconds
from drivers.errors import ConfigurationError, DeviceError

Procedure = Callable[[Job], Plan[tuple[MeasuredPositions, MeasuredPositions]]]
"""Function that takes a job and returns the plan of a whole run. The plan returns the measurements for the estimate,
and the measurements that verify the new table."""


@dataclass(frozen=True)
class PreflightResult:
    """Result of a preflight, the simulated execution of a whole plan.

    `measured` contains the simulated measurements for the estimate, and `verified` those that verify the new table.
    `timeline` maps the key of each step to the machine time in s at the end of the step. `steps` contains the steps
    that take time, in order. `machine_seconds` is the simulated time of the whole plan, `wall_seconds` is the time that
    the computation took, and `commands` is the number of steps.
    """

    measured: MeasuredPositions
    verified: MeasuredPositions
    timeline: Mapping[str, float]
    steps: Sequence[TimedStep]
    machine_seconds: float
    wall_seconds: float
    commands: int

    @property
    def machine_minutes(self) -> float:
        return self.machine_seconds / 60.0


def never_interrupted() -> None:
    """Do nothing. A preflight that cannot be interrupted calls this function after every step."""


def run_preflight(
    job: Job,
    start_mm: Point | None = None,
    procedure: Procedure | None = None,
    watch: Callable[[], None] = never_interrupted,
    *,
    with_proof: bool = True,
) -> PreflightResult:
    """Execute the plan of a whole run on a simulated machine without errors.

    `start_mm` contains the axis positions of the real machine in mm. If `start_mm` is None, the simulated machine
    starts at its own initial positions. `procedure` is a function that returns the plan; by default, this is the plan
    of a calibration. `watch` is called after every step and may raise an error to interrupt the preflight. `with_proof`
    is False if the plan measures no held-out positions.

    Raises PlanRefused if a step breaks a safety rule or fails; the error names the step and, for a collision, the two
    bodies that collide. Raises ConfigurationError if no held-out position can be measured although `with_proof`
    is True. Errors raised by `watch` are passed on.
    """
    plan = (procedure or whole_procedure)(job)
    began = wall_seconds()
    clock = VirtualClock()
    rig = assemble_preflight_rig(job, clock, start_mm)
    times = _Times(clock, time_model(job.machine, job.settings.timing), watch)
    rig.open()
    try:
        engine, carried = Engine(rig.actions(), observer=times.note), not job.rules.change.own_mounts
        checked = checked_plan(plan, job.settings.procedure, job.settings.stations, carried=carried)
        measured, verified = engine.run(checked)
    except (Aborted, Interrupted) as end:  # belongs to no step of the machine
        raise type(end)(end.message, hint=end.hint) from end
    except (DeviceError, MeasurementFault) as error:
        hint = _what_to_do(job, error.where.get("step", ""))
        raise PlanRefused(f"preflight: {error.message}", hint=hint, **error.where) from error
    finally:
        rig.close()
    if with_proof:
        _require_proof(verified)
    wall_s = wall_seconds() - began
    return PreflightResult(measured, verified, times.timeline, times.steps, clock.now(), wall_s, len(times.timeline))


def _what_to_do(job: Job, step: str) -> str:
    if job.settings.verification.positions_deg is None and any(f"/{position_key(p)}/" in step for p in job.held_out):
        return "nothing was moved; list other held-out positions in `verification.positions_deg`"
    if job.settings.procedure.paths == "plain":
        return (
            'nothing was moved; plain paths are not proved free; `procedure.paths = "shortest"` searches for free ones'
        )
    return "nothing was moved; the plan must change"


class _Times:
    """Recorder of the times of the steps. Motion of the simulated machine advances the clock; latencies are added
    here."""

    def __init__(self, clock: VirtualClock, model: TimeModel, watch: Callable[[], None]) -> None:
        self._clock = clock
        self._model = model
        self._watch = watch
        self._last_s = clock.now()
        self.timeline: dict[str, float] = {}
        self.steps: list[TimedStep] = []

    def note(self, step: Step, _: object) -> None:
        self._watch()
        motion_s, overhead_s = self._clock.now() - self._last_s, self._model.overhead_s(step)
        self._clock.sleep(overhead_s)
        self._last_s = self.timeline[step.key] = self._clock.now()
        if motion_s or overhead_s:
            self.steps.append(TimedStep(step, motion_s, overhead_s))


def _require_proof(verified: MeasuredPositions) -> None:
    """Raise ConfigurationError if no held-out position was measured, because the new table could not be verified."""
    if not verified.positions:
        raise ConfigurationError(
            "no held-out position has three balls within reach, so a new table could not be proved",
            key="verification.positions_deg",
            hint="choose orientations that the machine reaches at the stations of `verification`",
        )


def whole_procedure(job: Job) -> Plan[tuple[MeasuredPositions, MeasuredPositions]]:
    """Return the plan of the calibration `job`, which has three parts.

    The plan first prepares the probe (probe check, stylus qualification and reversal test). It then measures the
    position set and the held-out positions. Finally, it measures the held-out positions again, as a run does to verify
    the new compensation table.
    """
    prepared = yield from job.preparation_plan()
    order = replace(job.measuring_order, standing_at=prepared.standing_at, placed=prepared.placed)
    measured = yield from measure_with_repeats(order, job.layout, prepared.rules, job.repeat_rules)
    order = job.verification_order(measured.standing_at, measured.placed)
    verified = yield from measure_positions(order, job.layout, prepared.rules, measured.mount_poses)
    return measured, verified
