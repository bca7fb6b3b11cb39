"""Result of the comparison of the controller's active compensation with the journal of earlier runs, and of its
repair."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from agent.runs.unfinished_run import UnfinishedRun
from agent.runs.unproved_table import UnprovedTable


class CompensationState(Enum):
    """State of the controller's compensation, compared with the state expected from the journal of earlier runs."""

    AS_EXPECTED = "as the last run left it"
    NOT_ACTIVATED = "the former table acts; a new one was written or begun, and never activated"
    UNPROVED = "a new table acts that was never proved"
    WAITING = "a new table waits for the controller before it acts"
    LOST = "the controller no longer applies the table that the last run left active"
    CHANGED = "the active compensation is not the one expected after the last run"
    UNKNOWN = "there is no run to compare with"


class ReconcileAction(Enum):
    """Repair that the comparison of the controller with the journal has made."""

    NOTHING = "nothing had to be done"
    RESTORED = "the former table acts again"
    RESTORE_WAITS = "the former table acts again once the controller has been restarted or referenced"
    LEFT = "left as it is"


@dataclass(frozen=True)
class Reconciliation:
    """Result of a reconciliation, that is, of the comparison of the controller's compensation with the journal and of
    its repair.

    `active_bank` is the bank that is active after the repair. `waiting_bank` is the bank that the controller will
    activate later, or None. `unfinished` is the interrupted run, or None. `instruction` states the action that a person
    must take; it is empty if a person need not act. `unproved` is the unproved table if it is still active, and
    `refused` is the reason for which the controller did not reactivate the former table.
    """

    state: CompensationState
    action: ReconcileAction
    active_bank: int
    waiting_bank: int | None = None
    unfinished: UnfinishedRun | None = None
    instruction: str = ""
    unproved: UnprovedTable | None = None
    refused: str = ""

    @property
    def blocks_runs(self) -> bool:
        """True if a table must be proved or taken back before a new run may start."""
        return self.state in (CompensationState.UNPROVED, CompensationState.WAITING)

    @property
    def text(self) -> str:
        """Text for people in one line, with the state of the compensation, the repair and the instruction."""
        refused = f"the controller did not reactivate the former table: {self.refused}" if self.refused else ""
        bank = f"{self.state.value} (bank {self.active_bank} is active)"
        parts = [bank, self.action.value, refused, self.instruction]
        return "; ".join(part for part in parts if part)
