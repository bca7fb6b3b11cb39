"""Kind of run `calibrate`. The run measures the whole position set, writes a new compensation table and proves it with
held-out positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.execution.steps import Point, RunPlan
from agent.planning.cycle_time import expected_plan, plan_minutes
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, never_interrupted, run_preflight
from agent.planning.run_minutes import run_minutes
from agent.results.predicted_accuracy import preflight_estimate
from agent.runs.consent import Consent
from agent.runs.kinds.calibration import CalibrationTask, calibration
from agent.runs.kinds.sequential import SequentialEnd, SequentialTask, sequential_calibration
from agent.runs.kinds.sequential_plan import plan_sequential
from agent.runs.kinds.slot import AvailableTime
from agent.runs.planned_run import PlannedRun, StartConditions, plan_run
from agent.runs.reference_state import ReferenceState, full_calibration_need, reference_for


@dataclass(frozen=True)
class FullCalibration:
    """Kind of run that measures the whole position set and writes a new compensation table.

    `nights` is the number of nights since the last accepted night; if it is None, the number is computed from the date.
    `consent` states whether a table may be written although the machine has changed.

    If `sequential` is True, each position is chosen from what was measured before it, until the upper 95 % limit of the
    predicted VCE is below `target_vce_um` or the slot of `slot_minutes` is over. If `target_vce_um` is None, the whole
    slot is used; if `slot_minutes` is None, the slot is the machine time of the position set of the settings.
    """

    nights: float | None = None
    consent: Consent = Consent.ASK
    sequential: bool = False
    target_vce_um: float | None = None
    slot_minutes: float | None = None
    name: str = "calibrate"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        reference = reference_for(job, start.run)
        nights = nights_since(reference, self.nights, start.at)
        changed = full_calibration_need(job.settings.state_directory, start.run) is not None
        task = CalibrationTask(job, start.store, reference, nights, self.consent, changed)
        if self.sequential:
            return self._sequential(task, start, watch)
        planned = plan_run(job, self, start, lambda: calibration(task), watch)
        preflight_estimate(job, planned.preflight.measured)
        return planned

    def _sequential(self, task: CalibrationTask, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        job = task.job
        slot = run_minutes(job, calibration_of).total if self.slot_minutes is None else self.slot_minutes
        end = SequentialEnd(self.target_vce_um, AvailableTime(slot, job.settings.nightly.reserve_minutes))

        def planned_run(sequential: SequentialTask) -> PlannedRun:
            return plan_run(sequential.job, self, start, lambda: sequential_calibration(sequential), watch)

        def minutes_of(sequential: SequentialTask) -> float:
            watch()
            return plan_minutes(sequential.job, expected_plan(sequential_calibration(sequential)), start.start_mm)

        planned = plan_sequential(task, end, minutes_of, planned_run)
        preflight_estimate(planned.job, planned.preflight.measured)
        return planned


def calibration_of(job: Job) -> RunPlan:
    """Return the plan of a first calibration of `job`, with an operator at the machine."""
    return calibration(CalibrationTask(job))


def preflight_of(
    job: Job,
    start_mm: Point | None = None,
    watch: Callable[[], None] = never_interrupted,
    *,
    every_branch: bool = False,
) -> PreflightResult:
    """Return the preflight of a first calibration of `job`; the arguments are as for `run_preflight`."""
    return run_preflight(job, calibration_of, start_mm, watch, every_branch=every_branch)


def nights_since(reference: ReferenceState | None, stated: float | None, at: str) -> float:
    """Return the number of nights since the last accepted night.

    If `stated` is not None, it is returned. Otherwise, the number is computed from the date `at` (UTC); it is 0 if
    there is no accepted night.
    """
    if stated is not None:
        return stated
    return 0.0 if reference is None else reference.nights_until(at)
