"""Conversion of JSON text to a validated value. Errors name the file and the path of the key."""

from __future__ import annotations

import json
from typing import TypeVar

from twin.errors import FormatError
from twin.formats.toml_reading import StrictModel, validate_document

Section = TypeVar("Section", bound=StrictModel)


def read_json(text: str, source: str, kind: type[Section], *, format_name: str, remedy: str) -> Section:
    """Return the value of type `kind` given as JSON text.

    Raise FormatError if the text is invalid or contains NaN or infinity, or if its key `format` is not `format_name`;
    `remedy` then says what to do.
    """
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except RecursionError:
        raise FormatError("lists or objects are nested too deeply", file=source) from None
    except ValueError as error:
        raise FormatError(f"this is not valid JSON: {error}", file=source) from None
    if not isinstance(document, dict):
        raise FormatError("the document is not a JSON object ({…})", file=source)
    found = document.get("format")
    if found != format_name and isinstance(found, str):
        message = f"the file has the format '{found}', and this version of volcal reads '{format_name}'"
        raise FormatError(message, hint=remedy, file=source, key="format")
    return validate_document(document, source, kind)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number")
