"""Scatter of the homing that the last trial with homings has measured, read from the journal of the machine, and its
effect on the machine after the next homing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.execution.journal_reader import ANY_RUN, has_journal
from agent.execution.run_record import read_record, run_heads
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.results.decision_kinds import INPUTS, TRIAL
from agent.results.homing_scatter import AfterHoming, HomingScatter, MeasuredHoming
from agent.runs.reference_state import reference_for
from twin.identification import Estimate


def last_homing(state_directory: Path, machine: str, before_run: int = ANY_RUN) -> MeasuredHoming | None:
    """Return the scatter of the homing of the machine with the name `machine`, from the last complete trial in the
    journal of `state_directory` that has measured it; None if there is none. Only runs with numbers below `before_run`
    count. Raises InputError if the journal cannot be read."""
    if not has_journal(state_directory):
        return None
    for head in reversed(run_heads(state_directory)):
        row = head.row
        if row.kind != TRIAL or row.state != RunState.COMPLETE.value or row.run >= before_run:
            continue
        record = read_record(state_directory, row.run_id)
        measured = (record.decision(TRIAL) or {}).get("homing")
        if measured and (record.decision(INPUTS) or {}).get("machine") == machine:
            return MeasuredHoming(row.run_id, record.ended or record.started, HomingScatter.from_record(measured))
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
