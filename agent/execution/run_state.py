"""State of a run. Each change of the state is checked against the permitted changes, then written to the journal, then
announced to the caller of the run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import structlog

from agent.errors import JournalFailed
from agent.execution.journal import RunJournal
from agent.execution.states import FINAL, RunState, may_follow


@dataclass(frozen=True)
class Announcement:
    """Message from a run to its caller. `kind` is ``state``, ``progress`` or ``note``, `text` is the message in words,
    and `data` contains its values by name.
    """

    kind: str
    text: str
    data: Mapping[str, Any]


Listener = Callable[[Announcement], None]

log: structlog.stdlib.BoundLogger = structlog.get_logger()


class RunStateTracker:
    """State of one run. The methods write every change of the state to the journal and announce it to the caller of the
    run.

    An error of the listener does not concern the run: a machine that moves must be stopped, withdrawn and restored
    although nobody is shown so. The first such error is logged, and the listener is still called with what follows.
    """

    def __init__(self, journal: RunJournal, listener: Listener, replayed: deque[RunState] | None = None) -> None:
        """`replayed` contains the recorded states of a resumed run; they are not announced when the replay enters them
        again."""
        self._replayed = deque[RunState]() if replayed is None else replayed
        self._silent = False
        self._journal = journal
        self._listener = listener
        self._listener_failed = False
        self.state = RunState.IDLE
        self._held_in: RunState | None = None

    def enter(self, state: RunState, reason: str = "") -> None:
        """Change the state of the run to `state`.

        Raises ValueError if this change is not among the permitted changes; this would be a defect of the agent.
        """
        if not may_follow(self.state, state):
            raise ValueError(f"no change from {self.state.value} to {state.value}")
        former, self.state = self.state, state
        if self._replayed and self._replayed[0] is state:
            self._replayed.popleft()
            self._silent = True
            return
        try:
            self._announce(reason)
        except JournalFailed:
            if state in (RunState.COMPLETE, RunState.REFUSED):
                self.state = former  # the end is not recorded, so the run can still be ended safely
            raise

    def announce_again(self) -> None:
        """Announce the current state of a resumed run if it has not been announced yet. A resumed run first replays its
        recorded procedure, and the states entered during the replay are not announced.
        """
        if self._silent:
            self._announce("resumed")

    def _announce(self, reason: str) -> None:
        state, self._silent = self.state, False
        try:
            self._journal.state(state, reason, final=state in FINAL)
        finally:
            self._tell(Announcement("state", reason or state.value, {"state": state.value}))

    def may_hold(self) -> bool:
        """Return True if the run can be held in its present state."""
        return may_follow(self.state, RunState.HELD)

    def hold(self) -> None:
        """Change to the state HELD if this change is permitted from the current state; otherwise the state does not
        change.
        """
        if self.may_hold():
            self._held_in = self.state
            self.enter(RunState.HELD)

    def resume(self) -> None:
        """Return from the state HELD to the state in which the run was held. In other states, do nothing."""
        if self.state is RunState.HELD and self._held_in is not None:
            self.enter(self._held_in)

    def note(self, text: str, **data: object) -> None:
        """Write a note to the journal and announce it to the caller of the run. The state does not change."""
        try:
            self._journal.event("note", {"text": text, **data})
        finally:
            self._tell(Announcement("note", text, data))

    def announce_note(self, text: str) -> None:
        """Announce the note `text` to the caller of the run without writing it to the journal.

        The note is already in the journal, because it is part of a record that the plan has written there.
        """
        self._tell(Announcement("note", text, {}))

    def progress(self, text: str, **data: object) -> None:
        """Announce the progress of the run to its caller without writing it to the journal."""
        self._tell(Announcement("progress", text, data))

    def _tell(self, announcement: Announcement) -> None:
        try:
            self._listener(announcement)
        except (Exception, SystemExit) as error:  # noqa: BLE001  rich exits if the reader of its pipe is gone
            if not self._listener_failed:
                self._listener_failed = True
                with suppress(Exception):  # the log may go to the same terminal
                    log.warning("the display of the run has failed", error=repr(error))
