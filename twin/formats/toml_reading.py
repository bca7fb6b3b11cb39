"""Conversion of TOML text to a validated pydantic model. Errors name the file and the path of the key."""

from __future__ import annotations

import dataclasses
import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from twin.errors import FormatError


class StrictModel(BaseModel):
    """Base class of all models read from a file. Instances are frozen. An unknown key, NaN or infinity in the file is
    an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    former_keys: ClassVar[Mapping[str, str]] = {}
    """New name of each renamed key, by its old name. A file with an old key is refused with a message that gives the
    new name."""
    removed_keys: ClassVar[Mapping[str, str]] = {}
    """What to do about a key that no longer exists, by its name. A file with such a key is refused."""


_UNION_LABEL = re.compile(r"(float|int|bool|str|constrained-\w+)$|.*\[")

Section = TypeVar("Section", bound=BaseModel)


def forbid_unknown_keys(kind: type) -> BeforeValidator:
    """Return a validator that refuses unknown keys for the dataclass `kind`; pydantic itself ignores such keys.

    The class attribute `moved_keys` of `kind`, if it exists, gives the present place of keys of former versions.
    """
    known = {field.name for field in dataclasses.fields(kind)}
    moved: Mapping[str, str] = getattr(kind, "moved_keys", {})

    def check(value: object) -> object:
        unknown = sorted(set(value) - known) if isinstance(value, Mapping) else []
        if unknown and unknown[0] in moved:
            raise ValueError(f"key {unknown[0]!r} has moved: write {moved[unknown[0]]}")
        if unknown:
            raise ValueError(f"unknown key {unknown[0]!r}; known: {', '.join(sorted(known))}")
        return value

    return BeforeValidator(check)


def read_toml(text: str, source: str, kind: type[Section]) -> Section:
    """Return the value of type `kind` given as TOML text. Raise FormatError, which names the file `source`, if the text
    is invalid."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        hint = "Put text in quotes, lists in brackets, and section names in brackets on a line of their own"
        raise FormatError(f"this is not valid TOML: {error}", hint=hint, file=source) from None
    return validate_document(document, source, kind)


def validate_document(document: dict[str, Any], source: str, kind: type[Section]) -> Section:
    """Return the value of type `kind` from a parsed document. Raise FormatError, which names the file and the path of
    the key and gives a hint, if the document is invalid."""
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise _as_format_error(error, source, kind) from None


def with_current_keys(document: Mapping[str, Any], kind: type[BaseModel]) -> dict[str, Any]:
    """Return a copy of `document` in which former names of keys are replaced by the current names, without keys that no
    longer exist. The keys are those of the model class `kind` and of its sections.

    The function is used for documents that an earlier version of this program stored. In a file written by a user, a
    former key is an error instead.
    """
    former, removed = (kind.former_keys, kind.removed_keys) if issubclass(kind, StrictModel) else ({}, {})
    current = {former.get(key, key): value for key, value in document.items() if key not in removed}
    for key, value in current.items():
        field = kind.model_fields.get(key)
        section = _model_inside(field.annotation) if field else None
        if section is not None and isinstance(value, Mapping) and issubclass(section, StrictModel):
            current[key] = with_current_keys(value, section)
    return current


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
        return _describe_unknown(name, _section_at(kind, location[:-1]), known)
    if problem == "missing":
        if location and isinstance(location[-1], int):
            return f"the list is too short: value number {location[-1] + 1} is missing", ""
        return f"key '{name}' is missing", _known_keys_hint(known)
    if problem == "value_error":
        return text.removeprefix("Value error, "), ""
    return f"{text[:1].lower()}{text[1:]}, found {value!r:.80}", ""


def _describe_unknown(name: str, section: type[BaseModel] | None, known: list[str]) -> tuple[str, str]:
    if section is not None and issubclass(section, StrictModel):
        if name in section.former_keys:
            return (
                f"key '{name}' has been renamed",
                f"Write '{section.former_keys[name]}' instead; the reference page of this file states its meaning",
            )
        if name in section.removed_keys:
            return f"key '{name}' no longer exists", section.removed_keys[name]
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
