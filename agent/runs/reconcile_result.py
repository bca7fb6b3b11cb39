"""What a start finds the last run to have left in the controller, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from agent.runs.unfinished_run import UnfinishedRun


class Found(Enum):
    """The compensation, as the journal expects it and the controller has it."""

    AS_EXPECTED = "as the last run left it"
    NOT_ACTIVATED = "the former table acts; a new one was written or begun, and never activated"
    UNPROVED = "a new table acts that was never proved"
    WAITING = "a new table waits for the controller before it acts"
    CHANGED = "somebody else has changed the compensation"
    UNKNOWN = "there is no run to compare with"


class Done(Enum):
    NOTHING = "nothing had to be done"
    RESTORED = "the former table acts again"
    RESTORE_WAITS = "the former table acts again once the controller has been restarted or referenced"
    LEFT = "left as it is"


@dataclass(frozen=True)
class Reconciliation:
    """`unfinished`: the run that broke off, if one did. `active_bank` after whatever was done; `waiting_bank`: one that
    the controller will activate later. `person`: what a person must do; empty where nothing."""

    found: Found
    done: Done
    active_bank: int
    waiting_bank: int | None = None
    unfinished: UnfinishedRun | None = None
    person: str = ""

    @property
    def text(self) -> str:
        """For people: what was found, what was done, what is left to do."""
        parts = [f"{self.found.value} (bank {self.active_bank} is active)", self.done.value, self.person]
        return "; ".join(part for part in parts if part)
