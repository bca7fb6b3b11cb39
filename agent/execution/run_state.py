"""State of a run: every change is checked against the table, journaled, then announced."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from agent.execution.journal import RunJournal
from agent.execution.states import FINAL, RunState, may_follow


@dataclass(frozen=True)
class Announcement:
    """`kind`: ``state``, ``progress``, ``gate``, ``note``."""

    kind: str
    text: str
    data: Mapping[str, Any]


Listener = Callable[[Announcement], None]


class RunStateTracker:
    """State of one run and its announcements: every change of the state goes through here."""

    def __init__(self, journal: RunJournal, listener: Listener, replayed: deque[RunState] | None = None) -> None:
        """`replayed`: states that a resumed run has been in; entered again, they are not announced."""
        self._replayed = deque[RunState]() if replayed is None else replayed
        self._silent = False
        self._journal = journal
        self._listener = listener
        self.state = RunState.IDLE
        self._held_in: RunState | None = None

    def enter(self, state: RunState, reason: str = "") -> None:
        """Change the state. Raise ValueError, a defect of the agent, for a change that the table does not permit."""
        if not may_follow(self.state, state):
            raise ValueError(f"no change from {self.state.value} to {state.value}")
        self.state = state
        if self._replayed and self._replayed[0] is state:
            self._replayed.popleft()
            self._silent = True
            return
        self._announce(reason)

    def announce_again(self) -> None:
        """Announce the state in which a run resumes, once its replay is over."""
        if self._silent:
            self._announce("resumed")

    def _announce(self, reason: str) -> None:
        state, self._silent = self.state, False
        try:
            self._journal.state(state, reason, final=state in FINAL)
        finally:
            self._listener(Announcement("state", reason or state.value, {"state": state.value}))

    def hold(self) -> None:
        """Enter held if the table of states permits it; otherwise the machine stands still and the state stays."""
        if may_follow(self.state, RunState.HELD):
            self._held_in = self.state
            self.enter(RunState.HELD)

    def resume(self) -> None:
        """Return to the state that was held."""
        if self.state is RunState.HELD and self._held_in is not None:
            self.enter(self._held_in)

    def note(self, text: str, **data: object) -> None:
        """Journal and announce a note that changes nothing."""
        try:
            self._journal.event("note", {"text": text, **data})
        finally:
            self._listener(Announcement("note", text, data))

    def announce_note(self, text: str) -> None:
        """Announce a note that a record of the plan has journaled already."""
        self._listener(Announcement("note", text, {}))

    def progress(self, text: str, **data: object) -> None:
        """Announce progress without journaling it."""
        self._listener(Announcement("progress", text, data))
