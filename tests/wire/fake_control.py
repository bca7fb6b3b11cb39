"""Fake Control that records the requests it receives and passes through the states of a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from queue import Queue
from typing import Any

from agent.errors import Busy, NotAllowedInState, ResetMissing
from agent.execution.states import PACKML, RunState
from agent.runs.run_request import RunRequest, Source
from agent.service.alarms import alarm_of
from agent.service.control import Event, Question, Status
from drivers.errors import LinkLost, UserError

AT_REST = (RunState.IDLE, RunState.COMPLETE, RunState.REFUSED)


class FakeControl:
    def __init__(self) -> None:
        self._readers: list[Queue[Event]] = []
        self._events = 0
        self.begin_anew()

    def begin_anew(self) -> None:
        """Restart as the service does at start-up; subscribers stay subscribed."""
        self.asked: list[tuple[str, Any]] = []
        self.by = ""
        self.runs = 0
        self._status = Status("mill-7", RunState.IDLE, PACKML[RunState.IDLE], may=frozenset({"start"}))

    def now(self, state: RunState, **changes: Any) -> None:
        """Set the state that the run has reached."""
        self._status = replace(self._status, state=state, packml=PACKML[state], **changes)
        self.tell("state", state.value)

    def tell(self, kind: str, text: str, /, **data: Any) -> None:
        self._events += 1
        for reader in self._readers:
            reader.put(Event(self._events, kind, text, data))

    def fault(self) -> None:
        alarm = alarm_of(LinkLost("the mount does not answer", hint="check the cable", device="mount"))
        self.now(RunState.FAULTED, alarms=(alarm,), may=frozenset({"reset"}))
        self.tell("alarm", alarm.text, code=alarm.code)

    def ask(self, number: int) -> None:
        self._status = replace(self._status, question=Question(number, "Is the artefact at station 2?", 2))

    def status(self) -> Status:
        return self._status

    def start(self, request: RunRequest, by: str = "") -> str:
        self.by = by
        if self._status.state in (RunState.FAULTED, RunState.ABORTED):
            raise ResetMissing("reset first")
        if self._status.state not in AT_REST:
            raise Busy(f"run {self._status.run_id} is in progress")
        if request.position_set == "S99":
            raise UserError("there is no set S99")
        if request.position_set == "DEFECT":
            raise ZeroDivisionError("in the owner itself")
        self.asked.append(("start", request))
        return self._begin(request.kind, request.position_set)

    def resume_run(self, source: Source, by: str = "") -> str:
        self.by = by
        if self._status.unfinished is None:
            raise UserError("there is no unfinished run")
        self.asked.append(("resume_run", source))
        return self._begin("calibrate", None)

    def restore_former(self, by: str = "") -> None:
        self.by = by
        self.asked.append(("restore_former", None))

    def give_up(self, by: str = "") -> None:
        self.by = by
        self.asked.append(("give_up", None))

    def restore_table(self, run_id: str, role: str, source: Source, by: str = "") -> str:
        self.by = by
        self.asked.append(("restore_table", (run_id, role, source)))
        return self._begin("restore", None)

    def _begin(self, kind: str, position_set: str | None) -> str:
        self.runs += 1
        run = f"2031-05-{self.runs:02d}-{kind}"
        self.now(RunState.MEASURING, run_id=run, kind=kind, position_set=position_set, may=frozenset({"hold", "abort"}))
        return run

    def hold(self, by: str = "") -> None:
        self.by = by
        self.asked.append(("hold", None))
        if self._status.state is RunState.MEASURING:
            self.now(RunState.HELD)

    def resume(self, by: str = "") -> None:
        self.by = by
        if self._status.state is RunState.IDLE:
            raise NotAllowedInState("resume is not allowed in state idle", hint="only a run that is held")
        self.asked.append(("resume", None))
        if self._status.state is RunState.HELD:
            self.now(RunState.MEASURING)

    def abort(self, reason: str) -> None:
        self.asked.append(("abort", reason))
        if self._status.state in (RunState.MEASURING, RunState.HELD):
            self.now(RunState.ABORTED, may=frozenset({"reset"}))

    def reset(self, by: str = "") -> None:
        self.by = by
        self.asked.append(("reset", None))
        self.now(RunState.IDLE, alarms=(), may=frozenset({"start"}))

    def answer(self, number: int, yes: bool, by: str = "") -> None:
        self.by = by
        question = self._status.question
        if question is None or question.number != number:
            raise UserError(f"there is no question {number}")
        self.asked.append(("answer", (number, yes)))
        self._status = replace(self._status, question=None)

    @contextmanager
    def subscribe(self) -> Iterator[Queue[Event]]:
        reader: Queue[Event] = Queue()
        self._readers.append(reader)
        try:
            yield reader
        finally:
            self._readers.remove(reader)

    def count(self, what: str) -> int:
        return sum(1 for name, _ in self.asked if name == what)
