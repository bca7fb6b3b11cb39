"""Questions of a run to the operator: each goes to every endpoint, and the first answer counts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from agent.service.control import Question
from drivers.clock import Clock, Deadline
from drivers.errors import PermissionMissing, UserError
from drivers.roles import OperatorRequest
from twin.units import S_PER_MIN

POLL_S = 0.1


class Questions:
    """Open question of the run; at most one, since there is one run."""

    def __init__(self, changed: Callable[[Question | None, str], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._number = 0
        self._open: Question | None = None
        self._answer: bool | None = None

    @property
    def open(self) -> Question | None:
        return self._open

    def put(self, text: str, station: int | None) -> Question:
        with self._lock:
            self._number += 1
            question = self._open = Question(self._number, text, station)
            self._answer = None
        self._changed(question, text)
        return question

    def answer(self, number: int, yes: bool) -> None:
        """Answer the open question. UserError if `number` is not the open question, or has been answered."""
        with self._lock:
            question = self._open
            if question is None or question.number != number:
                now = "none is open" if question is None else f"open is number {question.number}"
                raise UserError(f"there is no open question {number}", hint=f"{now}; see `volcal status`")
            if self._answer is not None:
                raise UserError(f"question {number} has been answered already")
            self._answer = yes

    def answered(self) -> bool | None:
        return self._answer

    def close(self, outcome: str) -> None:
        with self._lock:
            self._open = None
        self._changed(None, outcome)


@dataclass(frozen=True)
class ServiceOperator:
    """Operator at the endpoints. It waits on the run's own clock, so that hold and abort are noticed.

    `attended`: a person at the machine has consented to the start; otherwise nobody could answer.
    """

    questions: Questions
    clock: Clock
    within_minutes: float
    attended: bool

    def ask(self, request: OperatorRequest) -> bool:
        """Return the answer. PermissionMissing if the run is unattended, or nobody answers in time."""
        if not self.attended:
            raise PermissionMissing(
                f"nobody can be asked: {request.text}",
                hint="the run was started without consent; start it with somebody at the machine",
            )
        deadline = Deadline.after(self.clock, self.within_minutes * S_PER_MIN)
        self.questions.put(request.text, request.station)
        outcome = "not answered"
        try:
            while (answer := self.questions.answered()) is None:
                if deadline.expired:
                    raise PermissionMissing(
                        f"nobody answered within {self.within_minutes:g} min: {request.text}",
                        hint="see `service.answer_timeout_minutes`",
                    )
                self.clock.sleep(POLL_S)
            outcome = "yes" if answer else "no"
            return answer
        finally:
            self.questions.close(outcome)
