"""Abandonment of an unfinished run.

The former table is reactivated if necessary, and the run ends as aborted.
"""

from __future__ import annotations

from pathlib import Path

from agent.execution.journal import Journal
from agent.execution.rig import Rig
from agent.execution.states import RunState
from agent.runs.reconcile import reconcile
from agent.runs.reconcile_result import ReconcileAction, Reconciliation


def abandon(rig: Rig, state_directory: Path, reason: str) -> Reconciliation:
    """Reactivate the former table if necessary, then set the unfinished run to ABORTED in the journal.

    If the compensation is left unrepaired, the run remains unfinished. `rig` must be open; nothing moves. Raises the
    errors of `reconcile`.
    """
    result = reconcile(rig, state_directory)
    run = result.unfinished
    if run is not None and result.action is not ReconcileAction.LEFT:
        journal = Journal(state_directory)
        try:
            record, _ = journal.continue_run(run.run, run.run_id, rig.clock)
            record.aside().state(RunState.ABORTED, f"given up: {reason}", final=True)
        finally:
            journal.close()
    return result
