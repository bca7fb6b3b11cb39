"""Result of comparing the controller's compensation with the journal at a start, and of the repair."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from agent.runs.unfinished_run import UnfinishedRun


class CompensationState(Enum):
    """Compensation in the controller against the one that the journal expects."""

    AS_EXPECTED = "as the last run left it"
    NOT_ACTIVATED = "the former table acts; a new one was written or begun, and never activated"
    UNPROVED = "a new table acts that was never proved"
    WAITING = "a new table waits for the controller before it acts"
    CHANGED = "somebody else has changed the compensation"
    UNKNOWN = "there is no run to compare with"


class ReconcileAction(Enum):
    """Repair carried out by the reconciliation."""

    NOTHING = "nothing had to be done"
    RESTORED = "the former table acts again"
    RESTORE_WAITS = "the former table acts again once the controller has been restarted or referenced"
    LEFT = "left as it is"


@dataclass(frozen=True)
class Reconciliation:
    """`unfinished`: the interrupted run, if there is one. `active_bank`: after the action. `waiting_bank`: one that the
    controller will activate later. `instruction`: what a person must do; empty if nothing."""

    state: CompensationState
    action: ReconcileAction
    active_bank: int
    waiting_bank: int | None = None
    unfinished: UnfinishedRun | None = None
    instruction: str = ""

    @property
    def text(self) -> str:
        """State, action and instruction in one line for people."""
        parts = [f"{self.state.value} (bank {self.active_bank} is active)", self.action.value, self.instruction]
        return "; ".join(part for part in parts if part)
