"""Abandonment of an unfinished run, which then ends in the state aborted.

If the run has left a new compensation table active that has not yet been confirmed by measurements, the table that was
active before the run is reactivated.
"""

from __future__ import annotations

from pathlib import Path

from agent.execution.journal import Journal
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import ReconcileAction, Reconciliation
from agent.runs.unproved_table import GIVEN_UP


def abandon(rig: Rig, state_directory: Path, reason: str) -> Reconciliation:
    """End the unfinished run by setting it to ABORTED in the journal.

    If the run has left a new compensation table active that has not yet been confirmed by measurements, the table that
    was active before the run is first reactivated. If `agent.runs.reconcile.reconcile`, which compares the controller
    with the journal, leaves the compensation unrepaired, the run remains unfinished, unless the controller has refused
    the former table: the run then ends with its table active, and the operator must act at the controller. `rig`, the
    devices of the machine, must be open; no axis moves.

    Raises DeviceError if the controller cannot be read, and InputError if the journal cannot be read.
    """
    result = reconcile(rig, state_directory)
    run = result.unfinished
    if run is not None and (result.action is not ReconcileAction.LEFT or result.refused):
        journal = Journal(state_directory)
        try:
            record = journal.continue_run(run.run, run.run_id, rig.clock)[0].aside()
            left = f"; {result.unproved.situation}" if result.refused and result.unproved is not None else ""
            record.event(GIVEN_UP, {"reason": reason, "refused": result.refused})
            record.state(RunState.ABORTED, f"given up: {reason}{left}", final=True)
        finally:
            journal.close()
    return result
