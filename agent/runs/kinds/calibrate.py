"""Kind of run `calibrate`. The run measures the whole position set, writes a new compensation table and proves it with
held-out positions (measured, but not used for the estimate)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.results.predicted_accuracy import preflight_estimate
from agent.runs.calibration import CalibrationRun
from agent.runs.consent import Consent
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.runs.reference_state import ReferenceState, full_calibration_need, reference_for


@dataclass(frozen=True)
class FullCalibration:
    """Kind of run that measures the whole position set and writes a new compensation table.

    `nights` is the number of nights since the last accepted night (the last run whose estimate was accepted as the
    reference); if it is None, the number is computed from the date. `consent` states whether a table may be written
    although the machine has changed.
    """

    nights: float | None = None
    consent: Consent = Consent.ASK
    name: str = "calibrate"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        preflight = run_preflight(job, start.start_mm, watch=watch)
        preflight_estimate(job, preflight.measured)
        reference = reference_for(job, start.run)
        nights = nights_since(reference, self.nights, start.at)
        changed = full_calibration_need(job.settings.state_directory, start.run) is not None
        return PlannedRun(
            job,
            self,
            start,
            preflight,
            lambda context: CalibrationRun(job, context, reference, nights, self.consent, changed=changed),
        )


def nights_since(reference: ReferenceState | None, stated: float | None, at: str) -> float:
    """Return the number of nights since the last accepted night (the last run whose estimate was accepted as the
    reference).

    If `stated` is not None, it is returned. Otherwise, the number is computed from the date `at` (UTC); it is 0 if
    there is no accepted night.
    """
    if stated is not None:
        return stated
    return 0.0 if reference is None else reference.nights_until(at)
