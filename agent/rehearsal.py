"""Preflight: the complete plan on the simulated machine with virtual time, before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from agent.assembly import assemble_rehearsal
from agent.execution.engine import Engine
from agent.execution.steps import Plan, Point, Step
from agent.job import Job
from agent.plans.measure import Measured, measure_positions
from drivers.clock import VirtualClock, wall_seconds
from drivers.errors import ConfigurationError, DeviceError, MeasurementFault, PlanRefused


@dataclass(frozen=True)
class Rehearsal:
    """What the run will be. `timeline`: step key → seconds of machine time when that step is done."""

    measured: Measured
    verified: Measured
    timeline: Mapping[str, float]
    machine_seconds: float
    wall_seconds: float
    commands: int

    @property
    def machine_minutes(self) -> float:
        return self.machine_seconds / 60.0


def rehearse(job: Job, start_mm: Point | None = None) -> Rehearsal:
    """Run the whole procedure on a machine without errors.

    `start_mm`: where the real machine stands; None for where the simulated one begins. Raises PlanRefused
    naming the step, and the two bodies where one would hit the other.
    """
    began = wall_seconds()
    clock = VirtualClock()
    rig = assemble_rehearsal(job, clock, start_mm)
    timeline: dict[str, float] = {}

    def note(step: Step, _: object) -> None:
        timeline[step.key] = clock.now()

    rig.open()
    try:
        measured, verified = Engine(rig.actions(), observer=note).run(whole_procedure(job))
    except (DeviceError, MeasurementFault) as error:
        raise PlanRefused(
            f"preflight: {error.message}", hint="nothing was moved; the plan must change", **error.where
        ) from error
    finally:
        rig.close()
    _require_proof(verified)
    return Rehearsal(measured, verified, timeline, clock.now(), wall_seconds() - began, len(timeline))


def _require_proof(verified: Measured) -> None:
    """Raise ConfigurationError where nothing could be measured with the new table active: it would act unproved."""
    if not verified.positions:
        raise ConfigurationError(
            "no held-out position has three balls within reach, so a new table could not be proved",
            key="verification.positions_deg",
            hint="choose orientations that the machine reaches at the stations of `verification`",
        )


def whole_procedure(job: Job) -> Plan[tuple[Measured, Measured]]:
    """Everything that moves: the set with the held-out positions, then the held-out positions again."""
    measured = yield from measure_positions(job.measuring, job.layout, job.rules)
    order = job.verifying(measured.standing_at)
    verified = yield from measure_positions(order, job.layout, job.rules, measured.standings)
    return measured, verified
