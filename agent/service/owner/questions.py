"""Questions of a run to the operator. Every endpoint shows them, and the first answer counts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from agent.service.control import Question
from drivers.clock import Clock, Deadline
from drivers.errors import PermissionMissing, UserError
from drivers.roles import OperatorRequest, PlacementRequest
from twin.units import S_PER_MIN

POLL_S = 0.1


class Questions:
    """Questions of the run in progress. At most one question is open at a time."""

    def __init__(self, changed: Callable[[Question | None, str], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._number = 0
        self._open: Question | None = None
        self._answer: bool | None = None

    @property
    def open(self) -> Question | None:
        return self._open

    def ask(self, text: str, station: int | None, placement: PlacementRequest | None = None) -> Question:
        with self._lock:
            self._number += 1
            question = self._open = Question(self._number, text, station, placement)
            self._answer = None
            self._changed(question, text)
        return question

    def answer(self, number: int, yes: bool) -> None:
        """Answer the question with the number `number`, which is then no longer open, although the run takes the answer
        only when it goes on. Raise UserError if this question is not open or has already been answered."""
        with self._lock:
            question = self._open
            if number == self._number and self._answer is not None:
                raise UserError(f"question {number} has already been answered")
            if question is None or question.number != number:
                now = "no question is open" if question is None else f"the open question has number {question.number}"
                raise UserError(f"question {number} is not open", hint=f"{now}; see `volcal status`")
            self._open, self._answer = None, yes
            self._changed(None, "yes" if yes else "no")

    def given_answer(self) -> bool | None:
        return self._answer

    def close(self) -> bool | None:
        """Close the question if it is open. Return its answer, None if it was not answered."""
        with self._lock:
            if self._open is not None:
                self._open = None
                self._changed(None, "not answered")
            return self._answer


@dataclass(frozen=True)
class ServiceOperator:
    """Device in the role of the operator. It asks the questions of a run at the endpoints.

    While a question is open, the device waits with the clock of the run, so that the run can be held or aborted.
    `attended` is True if a person at the machine has consented to the start and can answer.
    """

    questions: Questions
    clock: Clock
    within_minutes: float
    attended: bool

    def ask(self, request: OperatorRequest) -> bool:
        """Ask the question and wait for the answer. Return True if the answer is yes.

        Raise PermissionMissing if the run is unattended or if no answer arrives in time.
        """
        if not self.attended:
            raise PermissionMissing(
                f"no operator is present to answer: {request.text}",
                hint="the run was started without consent; start it with an operator at the machine",
            )
        deadline = Deadline.after(self.clock, self.within_minutes * S_PER_MIN)
        placement = request if isinstance(request, PlacementRequest) else None
        self.questions.ask(request.text, request.station, placement)
        try:
            while self.questions.given_answer() is None and not deadline.expired:
                self.clock.sleep(POLL_S)
        finally:
            answer = self.questions.close()
        if answer is None:
            raise PermissionMissing(
                f"no answer within {self.within_minutes:g} min: {request.text}",
                hint="see `service.answer_timeout_minutes`",
            )
        return answer
