"""Latencies that the last complete run of a machine has shown, read from its journal for the plan of the next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.latency_fit import latencies_of, suggested_settings
from agent.planning.time_model import time_model
from agent.results.decision_kinds import INPUTS, OUTCOME
from agent.results.run_time import LearnedLatency
from agent.runs.complete_runs import CompleteRun, complete_runs
from agent.runs.run_forecast import ENOUGH
from agent.settings.schema import Settings, TimingSettings


@dataclass(frozen=True)
class LastLatencies:
    """Latencies that the run `run_id` has shown."""

    run_id: str
    latencies: tuple[LearnedLatency, ...]


def last_latencies(state_directory: Path, machine: str, stated: TimingSettings) -> LastLatencies | None:
    """Return the latencies of the last complete run of the machine with the name `machine` in the journal of
    `state_directory` that has learned at least one of them; None if there is no such run. Raises InputError if the
    journal cannot be read.

    Only runs count whose settings file stated the same section `timing`, which is `stated`. A person who changes it
    afterwards knows better than a former run: what it has learned then no longer counts. `relocation_minutes` is
    compared only if the file states it, because its default was another one in former versions.
    """
    unstated = {"relocation_minutes"} - stated.model_fields_set
    expected = stated.model_dump(mode="json", exclude=unstated)
    for run in complete_runs(state_directory, machine):
        told = run.decision(OUTCOME).get("run_time")
        learned = _enough(LearnedLatency(**one) for one in told["latencies"]) if told else ()
        former = {name: value for name, value in _stated_timing(run).items() if name not in unstated}
        if learned and former == expected:
            return LastLatencies(run.row.run_id, learned)
    return None


def _stated_timing(run: CompleteRun) -> Mapping[str, object]:
    """Return the section `timing` of the settings file of a run. Runs of versions without learned latencies have it in
    their settings."""
    stated: Mapping[str, object] = run.decision(INPUTS).get("stated_timing") or run.settings.get("timing") or {}
    return stated


def _enough(latencies: Iterable[LearnedLatency]) -> tuple[LearnedLatency, ...]:
    """Return those latencies that are the mean of enough steps."""
    return tuple(one for one in latencies if one.count >= ENOUGH[one.kind])


def _permitted(suggested: Mapping[str, float]) -> dict[str, float]:
    """Return the latencies, each at most as long as the settings may state. A person may have taken longer, for whom
    nobody waits in a forecast."""
    return {name: min(value, _longest(name)) for name, value in suggested.items()}


def _longest(name: str) -> float:
    """Return the upper limit that the settings set to the value `name` of the section `timing`."""
    return min(float(one.le) for one in TimingSettings.model_fields[name].metadata if hasattr(one, "le"))


def prepare_next_job(settings: Settings, base: Path) -> Job:
    """Prepare the job of the next run, with the latencies of the last one, see `with_learned_latencies`."""
    return with_learned_latencies(prepare_job(settings, base), base)


def with_learned_latencies(job: Job, base: Path) -> Job:
    """Return `job` with the latencies of the machine's last complete run in place of those of the settings, so that
    paths, order, minutes and slots follow them; `job` itself if there is no such run, see `last_latencies`.

    `base` is the directory to which relative paths of the settings refer. The latencies are part of the settings of
    the job, which the journal stores. A resumed run has therefore the same plan, whatever a later run has shown.
    """
    timing = job.settings.timing
    learned = last_latencies(job.settings.state_directory, job.machine.name, timing)
    if learned is None:
        return job
    given = time_model(job.machine, timing)
    seconds = {**latencies_of(given), **{one.kind: one.learned_s for one in learned.latencies}}
    model = replace(
        given,
        command_latency_s=seconds["MoveTo"],
        touch_latency_s=seconds["TouchTowards"],
        turn_latency_s=seconds["OrientTo"],
        carrying_s=seconds["AskOperator"],
    )
    learned_timing = TimingSettings.model_validate({**timing.model_dump(), **_permitted(suggested_settings(model))})
    settings = job.settings.model_copy(update={"timing": learned_timing})
    return replace(prepare_job(settings, base), latencies_from=learned.run_id, stated_timing=timing)
