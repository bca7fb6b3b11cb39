"""Records of the journal in words, for messages and reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def in_words(record: Mapping[str, Any]) -> str:
    """`name value, name value`; numbers to four digits, empty values left out."""
    return ", ".join(f"{name} {_shown(value)}" for name, value in record.items() if value not in ("", None))


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return "[" + ", ".join(_shown(part) for part in value) + "]"
    return str(value)
