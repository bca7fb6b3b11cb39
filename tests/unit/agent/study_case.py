"""Study of the case study in this process, without messages and without a preflight."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.job import Job
from agent.studies.study import StudyCase
from agent.studies.workers import LocalWorkers
from twin.identification import Options

NOWHERE = Path("/nowhere/runs")


@cache
def shipped_job(stations: int | None = None) -> Job:
    """Return the job of the case study with its four stations, or with other stations. Runs that somebody has made with
    the shipped settings are not those of this job."""
    job = load_case(CASE_STUDY, stations=stations)
    return replace(job, settings=job.settings.model_copy(update={"state_directory": NOWHERE}))


def study_case(stations: int | None = 2, *, seed: int, machines: int = 4, **changes: Any) -> StudyCase:
    """Return the study case with this number of stations; `changes` replace fields of it."""
    made: dict[str, Any] = {
        "job": shipped_job(stations),
        "options": Options(),
        "workers": LocalWorkers(1),
        "progress": lambda *_: None,
        "prove": lambda _: None,
    }
    return StudyCase(**{**made, "seed": seed, "machines": machines, **changes})
