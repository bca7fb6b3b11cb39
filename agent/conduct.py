"""The state of a run, and who hears of it: every change is checked, journaled, then announced."""

from __future__ import annotations

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


class Conduct:
    """Owns the state of one run."""

    def __init__(self, journal: RunJournal, listener: Listener) -> None:
        self._journal = journal
        self._listener = listener
        self.state = RunState.IDLE
        self._held_in: RunState | None = None

    def enter(self, state: RunState, reason: str = "") -> None:
        """Change the state; a change that the table does not know is a defect and raises ValueError."""
        if not may_follow(self.state, state):
            raise ValueError(f"no way from {self.state.value} to {state.value}")
        self.state = state
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

    def progress(self, text: str, **data: object) -> None:
        """For who watches only; not journaled."""
        self._listener(Announcement("progress", text, data))
