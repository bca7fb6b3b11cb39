"""German of English texts, by the catalogue of sentences."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache, lru_cache
from importlib import resources
from typing import Final, Literal

from agent.language.records import WORDS

Language = Literal["en", "de"]
LANGUAGES: Final[tuple[Language, ...]] = ("en", "de")

SAID: Final = "said"
"""Name of a place that is filled with the words of a person, which stay as they are."""
_ISOLATED: Final = re.compile("[\u2068\u2069]")
PLACE: Final = re.compile(r"\{(\w+)\}")
_WHOLE_ERROR: Final = re.compile(r"(?P<message>.+?) \((?P<places>[a-z_]+ [^()]+)\)(?:\. (?P<hint>.+))?", re.DOTALL)
"""Form of an error in one line: message, places and hint (`drivers.errors.VolcalError`)."""
# neither part of a name, an address, a version or a path, nor followed by one of their signs
_DECIMAL: Final = re.compile(r"(?<![\w./:])(?<![^\W\d]-)([+\-−]?\d+)\.(\d+)(?![\w./:]*[\w/:])")
_INSTANT: Final = re.compile(
    r"(?<![\w./:-])(\d{4})-(\d{2})-(\d{2})(?:[T ](\d{2}:\d{2}(?::\d{2})?)(?:\.\d+)?|(?![\w./:-]*[\w/]))(?![\dT-])"
)
_SEPARATORS: Final = ("; ", ". ", ", ")
_REMEMBERED: Final = 2000
_DEEPEST: Final = 8
"""Number of sentences that lie inside of each other at most. A text beyond it stays in English: the work for any text
is then at most so many times that of looking for each sentence once."""


class Sentence:
    """Sentence of the catalogue. The text that fills a place may be empty."""

    def __init__(self, english: str, german: str) -> None:
        parts = PLACE.split(english)
        self.names = parts[1::2]
        self.german = german
        self.literals = parts[::2]
        self.letters = sum(map(len, self.literals))
        self._longest = max(self.literals, key=len)

    def filled(self, text: str) -> Mapping[str, str] | None:
        """Return what fills the places if `text` is this sentence; its first letter may be of either case.

        Each place is as short as the words after it permit, and the last one takes the rest. No character is looked at
        for two places, so the work grows with the length of the text.
        """
        if self._longest[1:] not in text or not _begins(text, self.literals[0]):
            return None
        at, values = len(self.literals[0]), list[str]()
        if not self.names:
            return {} if at == len(text) else None
        for literal in self.literals[1:-1]:
            found = text.find(literal, at)
            if found < 0:
                return None
            values.append(text[at:found])
            at = found + len(literal)
        end = len(text) - len(self.literals[-1])
        if end < at or not text.endswith(self.literals[-1]):
            return None
        return dict(zip(self.names, [*values, text[at:end]], strict=True))


def _begins(text: str, literal: str) -> bool:
    """Return True if the text begins with the literal, whose first letter may be of either case."""
    return text[:1].lower() == literal[:1].lower() and text.startswith(literal[1:], 1) if literal else True


@cache
def catalogue() -> dict[str, str]:
    """Return the German of each English sentence."""
    folder = resources.files("agent.language").joinpath("german")
    files = sorted(path.name for path in folder.iterdir() if path.name.endswith(".json"))
    pairs: dict[str, str] = {}
    for name in files:
        pairs.update(json.loads(folder.joinpath(name).read_text(encoding="utf-8")))
    return pairs | dict(WORDS.values())


@cache
def _sentences() -> tuple[Sentence, ...]:
    """Return the sentences, those with the most letters of their own first: they say most about a text."""
    return tuple(sorted((Sentence(*pair) for pair in catalogue().items()), key=lambda one: -one.letters))


def as_it_is(text: str) -> str:
    """Return a name or a text of a person with marks, so that it is not told in another language inside of a sentence
    (U+2068 and U+2069). `without_marks` removes them."""
    return f"\u2068{text}\u2069" if text else text


def without_marks(text: str) -> str:
    """Return the text without the marks of `as_it_is`."""
    return _ISOLATED.sub("", text)


def in_language(text: str, language: Language) -> str:
    """Return an English text of the program in the language. What the catalogue does not have stays in English."""
    return text if language == "en" else german(text)


def german(text: str) -> str:
    """Return the German of a text: of the sentence that it is, or of those of which it is composed."""
    return _german(text, _DEEPEST)


@lru_cache(maxsize=_REMEMBERED)
def _german(text: str, deepest: int) -> str:
    """Return the German of a text in which at most `deepest` sentences lie inside of each other."""
    if text in catalogue():
        return catalogue()[text]
    if text.startswith("\u2068") and text.find("\u2069") == len(text) - 1:
        return text
    if deepest == 0:
        return with_german_numbers(text)
    for sentence in _sentences():
        values = sentence.filled(text)
        if values is not None and text not in values.values():
            told = {name: value if name == SAID else _german(value, deepest - 1) for name, value in values.items()}
            return PLACE.sub(lambda place, told=told: told[place[1]], sentence.german)  # type: ignore[misc]
    return _composed(text, deepest - 1) or with_german_numbers(text)


def _composed(text: str, deepest: int) -> str | None:
    """Return the German of an error in one line, or of a text of several parts of which at least one is known."""
    error = _WHOLE_ERROR.fullmatch(text)
    if error is not None and (message := _german(error["message"], deepest)) != error["message"]:
        hint = f". {_german(error['hint'], deepest)}" if error["hint"] else ""
        return f"{message} ({with_german_numbers(error['places'])}){hint}"
    for separator in _SEPARATORS:
        parts = text.split(separator)
        if len(parts) > 1:
            told = [_german(part, deepest) for part in parts]
            if any(one != with_german_numbers(part) for one, part in zip(told, parts, strict=True)):
                return separator.join(told)
    return None


def with_german_numbers(text: str) -> str:
    """Return the text with decimal commas and German dates; names, versions and addresses stay as they are."""
    return _DECIMAL.sub(r"\1,\2", _INSTANT.sub(_german_instant, text))


def _german_instant(found: re.Match[str]) -> str:
    year, month, day, time = found.groups()
    return f"{day}.{month}.{year}" + (f" {time}" if time else "")
