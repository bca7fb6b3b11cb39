"""Latencies of former runs in the plan of the next, and the settings file that is changed afterwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.job import Job
from agent.results.decision_kinds import INPUTS, OUTCOME
from agent.results.journal_entries import inputs_of
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.last_latencies import with_learned_latencies
from agent.runs.origin import origin_record, read_origin
from agent.runs.planned_run import StartConditions
from agent.settings.schema import TimingSettings
from drivers.clock import VirtualClock

BASE = CASE_STUDY.parent


@pytest.fixture
def job(tmp_path: Path) -> Job:
    stated = load_case(CASE_STUDY)
    return replace(stated, settings=stated.settings.model_copy(update={"state_directory": tmp_path}))


def with_timing(job: Job, **changed: float) -> Job:
    timing = job.settings.timing.model_copy(update=changed)
    return replace(job, settings=job.settings.model_copy(update={"timing": timing}))


def complete(job: Job, run_id: str, touch_s: float, **inputs: Any) -> None:
    """Journal a complete run of `job` whose touches took `touch_s` beyond their motion."""
    journal = Journal(job.settings.state_directory)
    try:
        run = journal.start_run(run_id, "calibrate", job.settings.model_dump(mode="json"), "1.2.3", VirtualClock())
        run.decision(INPUTS, {**inputs_of(job), **inputs})
        latency = {"kind": "TouchTowards", "count": 500, "forecast_s": 0.079, "learned_s": touch_s}
        run.decision(OUTCOME, {"run_time": {"latencies": [latency]}})
        run.state(RunState.COMPLETE, final=True)
    finally:
        journal.close()


def learned(job: Job) -> tuple[str, float]:
    planned = with_learned_latencies(job, BASE)
    return planned.latencies_from, planned.settings.timing.touch_latency_s


def test_the_last_run_counts_although_it_was_itself_planned_with_learned_latencies(job: Job) -> None:
    complete(job, "one", 0.2)
    assert learned(job) == ("one", 0.2)
    complete(with_learned_latencies(job, BASE), "two", 0.3)
    assert learned(job) == ("two", 0.3)


def test_timing_that_is_changed_after_a_run_is_believed_until_a_run_is_complete_with_it(job: Job) -> None:
    complete(job, "one", 0.2)
    changed = with_timing(job, touch_latency_s=0.01)
    assert learned(changed) == ("", 0.01)
    complete(changed, "two", 0.02)
    assert learned(changed) == ("two", 0.02)
    assert learned(job) == ("one", 0.2)


def test_another_default_of_the_minutes_for_carrying_does_not_hide_former_runs(job: Job) -> None:
    stated = job.settings.timing.model_dump()
    del stated["relocation_minutes"]
    unstated = replace(job, settings=job.settings.model_copy(update={"timing": TimingSettings.model_validate(stated)}))
    complete(with_timing(job, relocation_minutes=0.0), "one", 0.2)
    assert learned(unstated) == ("one", 0.2)
    assert learned(with_timing(job, relocation_minutes=0.0)) == ("one", 0.2)
    assert learned(with_timing(job, relocation_minutes=7.0))[0] == ""
    assert learned(with_timing(unstated, turn_latency_s=7.0))[0] == ""


def test_a_run_of_a_version_without_learned_latencies_has_stated_what_its_settings_say(job: Job) -> None:
    complete(job, "one", 0.2, stated_timing=None)
    assert learned(job) == ("one", 0.2)
    assert learned(with_timing(job, turn_latency_s=7.0))[0] == ""


def test_a_resumed_run_knows_whose_latencies_it_was_planned_with(job: Job) -> None:
    complete(job, "one", 0.2)
    planned = with_learned_latencies(job, BASE)
    journal = Journal(job.settings.state_directory)
    try:
        run = journal.start_run("two", "calibrate", planned.settings.model_dump(mode="json"), "1.2.3", VirtualClock())
        run.decision(INPUTS, inputs_of(planned))
        start = StartConditions(2, "2026-11-28T01:00:00.000Z", (0.0, 0.0, 0.0))
        run.origin(origin_record(planned.settings, FullCalibration(), BASE, start))
        run.begun()
    finally:
        journal.close()
    with open_journal(job.settings.state_directory) as reader:
        assert read_origin(reader, 2).latencies_from == "one"
