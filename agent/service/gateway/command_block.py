"""Conversion of the command registers written by a panel to a request. Invalid values are refused before anything is
executed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from agent.runs.run_kinds import KINDS
from agent.runs.run_request import RunRequest, run_request
from agent.service.gateway.register_codec import plain_text, whole_number
from agent.service.gateway.registers import COMMAND, IN_COMMAND, Command, Form
from drivers.errors import InputError

T = TypeVar("T")
FIRST: Final = COMMAND[0].address
SIZE: Final = COMMAND[-1].end - FIRST
_SET_NAMES = re.compile(r"[A-Za-z0-9_.+-]*")  # text of a panel contains no blanks
_COMMANDS = {command.value: command for command in Command}
_FULL_ALLOWED = {0: None, 1: False, 2: True}


class ValueNotAllowed(Exception):
    """Error raised if a command register holds a value that is not allowed. The message names the register."""


@dataclass(frozen=True)
class CommandRequest:
    """One command as written by a panel.

    `numbers` maps the name of each numeric register to its value. `text` is the name of the position set; it is None if
    it contains invalid characters.
    """

    numbers: Mapping[str, int]
    text: str | None

    @property
    def sequence(self) -> int:
        return self.numbers["sequence"]

    @property
    def access_code(self) -> int:
        return self.numbers["access_code"]

    @property
    def content(self) -> tuple[int | str | None, ...]:
        """All register values of the command except the access code. They distinguish a repetition of a command from a
        different command with the same sequence number."""
        return (*(value for name, value in self.numbers.items() if name != "access_code"), self.text)

    def command(self) -> Command | None:
        return _COMMANDS.get(self.numbers["command"])

    def run_request(self) -> RunRequest:
        """Return the request for a run. Raise ValueNotAllowed if a register value is invalid."""
        if self.text is None or not _SET_NAMES.fullmatch(self.text):
            raise ValueNotAllowed("position_set: ASCII names of sets joined by +")
        fields = {
            "kind": _one_of("kind", self.numbers["kind"], dict(enumerate(KINDS, start=1))),
            "source": "panel",
            "position_set": self.text or None,
            "stations": _stations(self.numbers["stations"]),
            "slot_minutes": self.numbers["slot"] / 10 if self.numbers["slot"] else None,
            "full_allowed": _one_of("full_allowed", self.numbers["full_allowed"], _FULL_ALLOWED),
            "consent": _one_of("consent", self.numbers["consent"], {0: False, 1: True}),
        }
        try:
            return run_request(**fields)
        except InputError as error:
            raise ValueNotAllowed(str(error)) from error

    def answer(self) -> tuple[int, bool]:
        """Return the pair (number, yes): the number of the question that the panel answers, and True if the answer is
        yes. Raise ValueNotAllowed if the answer is invalid."""
        return self.numbers["question_number"], _one_of("answer", self.numbers["answer"], {1: True, 2: False})


def read_command(words: Sequence[int]) -> CommandRequest:
    """Return the command that is encoded in `words`, the register values of the whole command block."""
    numbers: dict[str, int] = {}
    for register in COMMAND:
        if register.form is not Form.TEXT:
            numbers[register.name] = whole_number(_words_of(words, register.name))
    return CommandRequest(numbers, plain_text(_words_of(words, "position_set")))


def _words_of(words: Sequence[int], name: str) -> Sequence[int]:
    register = IN_COMMAND[name]
    return words[register.address - FIRST : register.end - FIRST]


def _one_of(name: str, value: int, known: Mapping[int, T]) -> T:
    if value not in known:
        raise ValueNotAllowed(f"{name}: {value} is not one of {', '.join(map(str, known))}")
    return known[value]


def _stations(mask: int) -> list[int] | None:
    return [bit + 1 for bit in range(16) if mask >> bit & 1] or None
