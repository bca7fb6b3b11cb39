"""Conversion of TOML text to a validated pydantic model. Errors name the file and the path of the key."""

from __future__ import annotations

import dataclasses
import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from twin.errors import FormatError


class StrictModel(BaseModel):
    """Base class of all models read from a file. Instances are frozen. An unknown key, NaN or infinity in the file is
    an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


MAX_TOML_CHARACTERS = 1_000_000
MAX_KEY_PARTS = 32
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MAX_KEY_PARTS}}}""")
_UNION_LABEL = re.compile(r"(float|int|bool|str|constrained-\w+)$|.*\[")

Section = TypeVar("Section", bound=BaseModel)


def forbid_unknown_keys(kind: type) -> BeforeValidator:
    """Return a validator that refuses unknown keys for the dataclass `kind`; pydantic itself ignores such keys."""
    known = {field.name for field in dataclasses.fields(kind)}

    def check(value: object) -> object:
        unknown = sorted(set(value) - known) if isinstance(value, Mapping) else []
        if unknown:
            raise ValueError(f"unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
        return value

    return BeforeValidator(check)


def read_toml(text: str, source: str, kind: type[Section]) -> Section:
    """Return the value of type `kind` given as TOML text. Raise FormatError, which names the file `source`, if the text
    is invalid."""
    return validate_document(parse_toml(text, source), source, kind)


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Return the document given as TOML text. Raise FormatError, which names the file `source`, if the text is invalid,
    too long, or nested too deeply.

    The limits keep the time of the parser below some seconds: its time and memory grow with the square of the number
    of parts of a dotted key.
    """
    if len(text) > MAX_TOML_CHARACTERS:
        message = f"this TOML file has {len(text)} characters, at most {MAX_TOML_CHARACTERS} are read"
        raise FormatError(message, hint="Check that this is the right file", file=source)
    long_key = _LONG_KEY.search(text)
    if long_key is not None:
        line = text.count("\n", 0, long_key.start()) + 1
        raise FormatError(f"a key has more than {MAX_KEY_PARTS} parts", file=source, line=line)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise FormatError("lists or tables are nested too deeply", file=source) from None
    except ValueError as error:  # also of numbers with thousands of digits, which Python does not convert
        hint = "Put text in quotes, lists in brackets, and section names in brackets on a line of their own"
        raise FormatError(f"this is not valid TOML: {error}", hint=hint, file=source) from None


def validate_document(document: dict[str, Any], source: str, kind: type[Section]) -> Section:
    """Return the value of type `kind` from a parsed document. Raise FormatError, which names the file and the path of
    the key and gives a hint, if the document is invalid."""
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise _as_format_error(error, source, kind) from None


def key_path(location: Sequence[str | int]) -> str:
    """Return a location such as `("axes", "X", "range_mm", 0)` as `axes.X.range_mm[0]`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _as_format_error(error: ValidationError, source: str, kind: type[BaseModel]) -> FormatError:
    problems = sorted(error.errors(include_url=False), key=lambda problem: problem["type"] != "extra_forbidden")
    start = _location(problems[0]["loc"])
    same = [problem for problem in problems if _location(problem["loc"]).startswith(start)]
    worst = max(same, key=lambda problem: len(_without_union_labels(problem["loc"])))
    key = _location(worst["loc"])
    message, hint = _describe(worst["type"], worst["msg"], worst.get("input"), worst["loc"], kind)
    others = {_location(problem["loc"]) for problem in problems}
    others = {other for other in others if not (key.startswith(other) or other.startswith(key))}
    if others:
        message = f"{message}; also wrong in this file: {', '.join(sorted(others))}"
    return FormatError(message, hint=hint, file=source, key=key)


def _describe(
    problem: str, text: str, value: object, raw_location: Sequence[str | int], kind: type[BaseModel]
) -> tuple[str, str]:
    location = _without_union_labels(raw_location)
    known = _known_keys(kind, location[:-1])
    name = str(location[-1]) if location else ""
    if problem == "extra_forbidden":
        return _describe_unknown(name, known)
    if problem == "missing":
        if location and isinstance(location[-1], int):
            return f"the list is too short: value number {location[-1] + 1} is missing", ""
        return f"key '{name}' is missing", _known_keys_hint(known)
    if problem == "value_error":
        return text.removeprefix("Value error, "), ""
    return f"{text[:1].lower()}{text[1:]}, found {value!r:.80}", ""


def _describe_unknown(name: str, known: list[str]) -> tuple[str, str]:
    close = difflib.get_close_matches(name, known, n=1)
    return f"unknown key '{name}'", f"Did you mean '{close[0]}'?" if close else _known_keys_hint(known)


def _known_keys_hint(known: list[str]) -> str:
    return f"Known keys here: {', '.join(known)}" if known else ""


def _known_keys(kind: type[BaseModel], location: list[str | int]) -> list[str]:
    section = _section_at(kind, location)
    return sorted(section.model_fields) if section else []


def _section_at(kind: type[BaseModel], location: list[str | int]) -> type[BaseModel] | None:
    current: type[BaseModel] | None = kind
    for part in location:
        if current is None:
            return None
        if isinstance(part, str) and part in current.model_fields:
            current = _model_inside(current.model_fields[part].annotation)
    return current


def _model_inside(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_inside(part))), None)


def _location(location: Sequence[str | int]) -> str:
    return key_path(_without_union_labels(location)) or "(whole file)"


def _without_union_labels(location: Sequence[str | int]) -> list[str | int]:
    """Return the location without the labels that pydantic adds for branches of a union (such as `list[float]`)."""
    return [part for part in location if isinstance(part, int) or not _UNION_LABEL.match(part)]
