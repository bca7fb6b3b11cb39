"""Latencies that the last complete run of a machine has shown, read from its journal for the forecast of the next."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.execution.journal_reader import has_journal
from agent.execution.run_record import read_record, run_heads
from agent.execution.states import RunState
from agent.planning.cycle_time import TimedStep
from agent.planning.job import Job
from agent.planning.latency_fit import latencies_of
from agent.planning.preflight import PreflightResult
from agent.planning.time_model import takes_time, time_model
from agent.results.decision_kinds import INPUTS, OUTCOME
from agent.results.run_time import LearnedLatency
from twin.units import S_PER_MIN


@dataclass(frozen=True)
class LastLatencies:
    """Latencies that the run `run_id` has shown."""

    run_id: str
    latencies: tuple[LearnedLatency, ...]

    def minutes(self, job: Job, preflight: PreflightResult) -> float:
        """Return the machine minutes of the run that `preflight` has walked, with these latencies in place of those of
        the settings of `job`."""
        given_s = latencies_of(time_model(job.machine, job.settings.timing))
        learned_s = {one.kind: one.learned_s for one in self.latencies}

        def more_s(timed: TimedStep) -> float:
            kind = type(timed.step).__name__
            return learned_s[kind] - given_s[kind] if kind in learned_s and takes_time(timed.step) else 0.0

        return preflight.machine_minutes + sum(more_s(timed) for timed in preflight.steps) / S_PER_MIN


def last_latencies(state_directory: Path, machine: str) -> LastLatencies | None:
    """Return the latencies of the last complete run of the machine with the name `machine` in the journal of
    `state_directory`; None if there is no such run. Raises InputError if the journal cannot be read."""
    if not has_journal(state_directory):
        return None
    complete = [head.row.run_id for head in run_heads(state_directory) if head.row.state == RunState.COMPLETE.value]
    for run_id in reversed(complete):
        record = read_record(state_directory, run_id)
        told = (record.decision(OUTCOME) or {}).get("run_time")
        if told and (record.decision(INPUTS) or {}).get("machine") == machine:
            return LastLatencies(run_id, tuple(LearnedLatency(**one) for one in told["latencies"]))
    return None
