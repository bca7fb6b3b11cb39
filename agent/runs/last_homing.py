"""Scatter of the homing that the last trial with homings has measured, read from the journal of the machine, and its
effect on the machine after the next homing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.execution.journal_reader import ANY_RUN
from agent.planning.job import Job
from agent.results.decision_kinds import TRIAL
from agent.results.homing_scatter import AfterHoming, HomingScatter, MeasuredHoming
from agent.runs.complete_runs import complete_runs
from agent.runs.reference_state import reference_for
from twin.identification import Estimate


def last_homing(state_directory: Path, machine: str, before_run: int = ANY_RUN) -> MeasuredHoming | None:
    """Return the scatter of the homing of the machine with the name `machine`, from the last complete trial in the
    journal of `state_directory` that has measured it; None if there is none. Only runs with numbers below `before_run`
    count. Raises InputError if the journal cannot be read."""
    for run in complete_runs(state_directory, machine, before_run):
        measured = run.decision(TRIAL).get("homing")
        if measured:
            return MeasuredHoming(run.row.run_id, run.row.ended or run.row.started, HomingScatter.from_record(measured))
    return None


def after_homing(job: Job, estimate: Estimate | None = None, before_run: int = ANY_RUN) -> AfterHoming | None:
    """Return the effect of the next homing on the machine of `job`; None if its scatter has not been measured.

    The errors that the table corrects are those of `estimate`, or else those of the last accepted night. If there is
    none either, they are those expected of the machine's family. Raises InputError if the journal cannot be read.
    """
    homing = last_homing(job.settings.state_directory, job.machine.name, before_run)
    if homing is None:
        return None
    reference = reference_for(job, before_run) if estimate is None else None
    known = estimate if reference is None else reference.estimate
    if known is not None:
        return AfterHoming.of(homing, known.model, known.parameters[:, None], job.tool_offset_mm)
    factor = np.diag(job.machine.family.prior_standard_deviation)
    return AfterHoming.of(homing, job.machine.model, factor, job.tool_offset_mm)
