"""Requester of a run in words, from the journal event "asked". History, reports and the service use the same words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

BY = "by"
"""Key of the name of the paired client in the event; the event of a request without a name does not have it."""


def requester_of(asked: Mapping[str, Any] | None) -> str:
    """Return the source of a request, followed by the name of the client that sent it if it is known. A run without
    such an event was started by a command that carries runs out itself."""
    found = asked or {}
    source, name = str(found.get("source", "command line")), str(found.get(BY, ""))
    return f"{source} ({name})" if name else source


def named(by: str) -> dict[str, str]:
    """Return the entry of a record that says who asked; it is empty if nobody is named."""
    return {BY: by} if by else {}
