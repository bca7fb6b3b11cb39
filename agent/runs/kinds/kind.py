"""Kinds of run: each decides what will be measured, runs the preflight and says who carries it out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.results.predicted_accuracy import preflight_estimate
from agent.runs.calibration import CalibrationRun
from agent.runs.consent import Consent
from agent.runs.guarded_run import GuardedRun, Means
from agent.runs.reference_state import LastAccepted, accepted_for
from agent.runs.start_conditions import Outset


@dataclass(frozen=True)
class Ready:
    """A run that has passed its preflight: `job` as it will be measured, and what carries it out."""

    job: Job
    preflight: PreflightResult
    begin: Callable[[Means], GuardedRun]


class Kind(Protocol):
    """`name` as the journal keeps it."""

    @property
    def name(self) -> str: ...

    def ready(self, job: Job, outset: Outset) -> Ready:
        """Decide what will be measured and run the preflight from the machine's position; the same `outset` gives the
        same result. Raise PlanRefused or UserError if it cannot be done."""
        ...


@dataclass(frozen=True)
class FullCalibration:
    """The whole set. `nights` since the last accepted night; None: by the calendar. `consent` to a change."""

    nights: float | None = None
    consent: Consent = Consent.ASK
    name: str = "calibrate"

    def ready(self, job: Job, outset: Outset) -> Ready:
        preflight = run_preflight(job, outset.start_mm, watch=outset.watch)
        preflight_estimate(job, preflight.measured)
        last = accepted_for(job, outset.run)
        nights = nights_since(last, self.nights, outset.at)
        return Ready(job, preflight, lambda means: CalibrationRun(job, means, last, nights, self.consent))


def nights_since(last: LastAccepted | None, stated: float | None, at: str) -> float:
    """As stated, else by the calendar."""
    if stated is not None:
        return stated
    return 0.0 if last is None else last.nights_until(at)
