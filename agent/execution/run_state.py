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
        """`replayed`: states that a run which is gone on with has been in; entered again, they are no news."""
        self._replayed = deque[RunState]() if replayed is None else replayed
        self._silent = False
        self._journal = journal
        self._listener = listener
        self.state = RunState.IDLE
        self._held_in: RunState | None = None

    def enter(self, state: RunState, reason: str = "") -> None:
        """Change the state; a change that the table does not know is a defect and raises ValueError."""
        if not may_follow(self.state, state):
            raise ValueError(f"no way from {self.state.value} to {state.value}")
        self.state = state
        if self._replayed and self._replayed[0] is state:
            self._replayed.popleft()
            self._silent = True
            return
        self._announce(reason)

    def announce_again(self) -> None:
        """A replay is over: say where the run goes on."""
        if self._silent:
            self._announce("gone on with")

    def _announce(self, reason: str) -> None:
        state, self._silent = self.state, False
        try:
            self._journal.state(state, reason, final=state in FINAL)
        finally:
            self._listener(Announcement("state", reason or state.value, {"state": state.value}))

    def hold(self) -> None:
        """Held, where the table of states has a way there; elsewhere the machine stands still and the state stays."""
        if may_follow(self.state, RunState.HELD):
            self._held_in = self.state
            self.enter(RunState.HELD)

    def go_on(self) -> None:
        """Back to what was held."""
        if self.state is RunState.HELD and self._held_in is not None:
            self.enter(self._held_in)

    def note(self, text: str, **data: object) -> None:
        """Something worth remembering that changes nothing."""
        try:
            self._journal.event("note", {"text": text, **data})
        finally:
            self._listener(Announcement("note", text, data))

    def told(self, text: str) -> None:
        """What a plan's own record says already; not journaled again."""
        self._listener(Announcement("note", text, {}))

    def progress(self, text: str, **data: object) -> None:
        """For who watches only; not journaled."""
        self._listener(Announcement("progress", text, data))
