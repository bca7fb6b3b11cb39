"""Numbers and times in a text, as they are written in German."""

from __future__ import annotations

import re
from typing import Final

# neither part of a name, an address, a version or a path, nor followed by one of their signs
_DECIMAL: Final = re.compile(r"(?<![\w./:])([+\-−]?\d+)\.(\d+)(?![\w./:]*[\w/:])")
_INSTANT: Final = re.compile(r"\b(\d{4})-(\d{2})-(\d{2})(?:[T ](\d{2}:\d{2}(?::\d{2})?)(?:\.\d+)?)?(?![\dT-])")


def with_german_numbers(text: str) -> str:
    """Return the text with decimal commas and German dates; names, versions and addresses stay as they are."""
    return _DECIMAL.sub(r"\1,\2", _INSTANT.sub(_german_instant, text))


def _german_instant(found: re.Match[str]) -> str:
    year, month, day, time = found.groups()
    return f"{day}.{month}.{year}" + (f" {time}" if time else "")
