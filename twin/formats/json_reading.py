"""Conversion of JSON text to a validated value. Errors name the file and the path of the key."""

from __future__ import annotations

import json
from typing import TypeVar

from twin.errors import FormatError
from twin.formats.toml_reading import StrictModel, validate_document

Section = TypeVar("Section", bound=StrictModel)


def read_json(text: str, source: str, kind: type[Section]) -> Section:
    """Return the value of type `kind` given as JSON text. Raise FormatError if the text is invalid or contains NaN or
    infinity."""
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except ValueError as error:
        raise FormatError(f"this is not valid JSON: {error}", file=source) from None
    if not isinstance(document, dict):
        raise FormatError("the document is not a JSON object ({…})", file=source)
    return validate_document(document, source, kind)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")
