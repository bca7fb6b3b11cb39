"""One value that can be stated about a new machine, and the answers about all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from agent.files import translated
from agent.planning.new_machine.machine_setup import PROPOSED, STATED
from agent.planning.new_machine.new_setup import NewSetup
from agent.planning.new_machine.toml_text import TomlText, Value
from drivers.errors import InputError
from drivers.roles import AxisLimits
from twin.machine.kinematic_chain import AXES

Answer = TypeVar("Answer")

READ = "read from the controller"
LONGEST_TEXT = 400


class FieldKind(Enum):
    """Form of a value. A triple is three numbers, of X, Y and Z; a travel is a length or LOWEST:HIGHEST."""

    TEXT = "text"
    CHOICE = "choice"
    NUMBER = "number"
    INTEGER = "integer"
    TRIPLE = "triple"
    TRAVELS = "travels"
    FILE = "file"


@dataclass(frozen=True, kw_only=True)
class SetupField(Generic[Answer]):
    """Value that a person can state about a new machine, with its appearance on the command line, on the set-up page
    and in the files.

    `flag` is the option of `volcal init`, and `step` the step of the set-up page on which the field is. `en` and `de`
    are its label on the page, `option` its help text if it is not the English label. `question` is put to the person in
    the terminal if the value is neither stated nor read from the controller; if there is no question, the proposal is
    used. A number must lie between `lowest` and `highest`. `words` maps each choice to its English and German label, or
    to None if the page shows the choice itself. `metavar` stands for the value in the help text.

    `meaning` turns the text into the value and raises DataError if it has none; `check` raises DataError if the value
    contradicts the other answers. `reported` is the value that a controller reports, `proposal` the text of the
    proposal, and `origin` says where the proposal comes from. `shown` returns the text of the value in a given set-up,
    or None if the set-up does not contain the value. `key` and `comment` are the name and the explanation of the value
    in the files.
    """

    flag: str
    step: str
    kind: FieldKind
    meaning: Callable[[str], Answer]
    en: str
    de: str
    option: str = ""
    question: str | Callable[[Answers], str] = ""
    words: Mapping[str, tuple[str, str] | None] = field(default_factory=dict)
    lowest: float = -math.inf
    highest: float = math.inf
    metavar: str | None = None
    check: Callable[[Answers, Answer], object] | None = None
    reported: Callable[[AxisLimits], Answer | None] | None = None
    proposal: Callable[[Answers], str] | None = None
    origin: str | Callable[[Answers], str] = PROPOSED
    shown: Callable[[NewSetup], str | None] | None = None
    key: str = ""
    comment: str = ""

    @property
    def name(self) -> str:
        """Name of the field, which is a Python identifier."""
        return {"--class": "machine_class"}.get(self.flag, self.flag.removeprefix("--").replace("-", "_"))

    @property
    def choices(self) -> tuple[str, ...]:
        return tuple(self.words)

    def read(self, text: str, answers: Answers) -> Answer:
        """Return the value of a text. Raises InputError, which names the option, if it has none."""
        self.refuse_malformed(text)
        with translated(InputError, option=self.flag):
            value = self.meaning(text)
            if self.check is not None:
                self.check(answers, value)
        return value

    def refuse_malformed(self, text: str) -> None:
        """Raise InputError, which names the option, if `text` does not have the form of a value."""
        parts = text.split()
        try:
            if len(text) > LONGEST_TEXT or not text.isprintable():
                raise ValueError
            match self.kind:
                case FieldKind.CHOICE if text.strip() not in self.words:
                    raise ValueError
                case FieldKind.NUMBER:
                    self._refuse_beyond(float(text))
                case FieldKind.INTEGER:
                    self._refuse_beyond(int(text))
                case FieldKind.TRIPLE | FieldKind.TRAVELS if len(parts) != len(AXES):
                    raise ValueError
                case FieldKind.TRIPLE:
                    for part in parts:
                        self._refuse_beyond(float(part))
        except ValueError:
            raise InputError(f"{text[:LONGEST_TEXT]!r} is not {self._expected}", option=self.flag) from None

    def write(self, text: TomlText, value: Value, origins: Mapping[str, str]) -> None:
        """Add the value to a file, with its explanation and its origin."""
        known = (self.comment, origins.get(self.name, ""))
        text.key(self.key, value, "; ".join(part for part in known if part))

    def _refuse_beyond(self, value: float) -> None:
        if not (math.isfinite(value) and self.lowest <= value <= self.highest):
            raise ValueError

    @property
    def _expected(self) -> str:
        ends = ""
        if math.isfinite(self.highest):
            ends = f" from {self.lowest:g} to {self.highest:g}"
        elif math.isfinite(self.lowest):
            ends = f" of at least {self.lowest:g}"
        return {
            FieldKind.CHOICE: f"one of {', '.join(self.choices)}",
            FieldKind.NUMBER: f"a number{ends}",
            FieldKind.INTEGER: f"a whole number{ends}",
            FieldKind.TRIPLE: f"three numbers{ends}, for X, Y and Z, separated by blanks",
            FieldKind.TRAVELS: "three travels, of X, Y and Z, separated by blanks",
        }.get(self.kind, f"one line of at most {LONGEST_TEXT} characters")


class SetupQuestions(Protocol):
    """Source of the answers that no option gave."""

    def ask(self, field: SetupField[Any], question: str, read: Callable[[str], Answer], proposal: str | None) -> Answer:
        """Return the answer to `question`, converted by `read`.

        Raises InputError, which names the option of the field, if there is neither an answer nor a `proposal`.
        """
        ...


class ProposalsOnly:
    """Answers without asking anyone: each answer is the proposal."""

    def ask(self, field: SetupField[Any], question: str, read: Callable[[str], Answer], proposal: str | None) -> Answer:
        if proposal is None:
            listed = f"; one of {', '.join(field.choices)}" if field.choices else ""
            message = f"{field.flag} is needed: {question}{listed}"
            raise InputError(message, hint=f"state {field.flag}", option=field.flag)
        return read(proposal)


@dataclass
class Answers:
    """Values of the fields of one machine. A value that is not known yet is asked when it is first needed.

    `texts` are the stated values by name of the field, `directory` is the directory of the machine, and `limits` are
    what its controller reports. `origins` maps the names of the fields answered so far to the origins of the values.
    """

    texts: Mapping[str, str]
    questions: SetupQuestions
    directory: Path
    limits: AxisLimits | None = None
    origins: dict[str, str] = field(default_factory=dict)
    _values: dict[str, Any] = field(default_factory=dict)

    def states(self, field: SetupField[Any]) -> bool:
        """Return True if a value of the field is stated."""
        return bool(self.texts.get(field.name, "").strip())

    def __getitem__(self, field: SetupField[Answer]) -> Answer:
        """Return the value that is stated, read, answered or proposed, in this order.

        Raises InputError, which names the option, if it is missing or impossible.
        """
        if field.name not in self._values:
            self._values[field.name], self.origins[field.name] = self._resolved(field)
        value: Answer = self._values[field.name]
        return value

    def stated(self, field: SetupField[Answer]) -> Answer | None:
        """Return the stated value, None if there is none."""
        return self[field] if self.states(field) else None

    def refuse_stated(self, unused: Iterable[SetupField[Any]], reason: str, hint: str) -> None:
        """Raise InputError, which names the option, if one of the `unused` fields, of which no file can contain the
        value, is stated. `reason` completes the sentence that begins with the option."""
        for one in unused:
            if self.states(one):
                raise InputError(f"{one.flag} {reason}", hint=hint, option=one.flag)

    def _resolved(self, field: SetupField[Answer]) -> tuple[Answer, str]:
        """Return a value and its origin."""
        if self.states(field):
            return field.read(self.texts[field.name].strip(), self), STATED
        if field.reported and self.limits and (value := field.reported(self.limits)) is not None:
            return value, READ
        proposal = field.proposal(self) if field.proposal else None
        origin = field.origin if isinstance(field.origin, str) else field.origin(self)
        question = field.question if isinstance(field.question, str) else field.question(self)
        source = self.questions if question else ProposalsOnly()
        value = source.ask(field, question, lambda text: field.read(text, self), proposal)
        return value, STATED if proposal is None or value != field.read(proposal, self) else origin
