"""Settings as a list of keys with their values, as the settings file and docs/reference/settings.md name them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from agent.settings.schema import Settings

REMOVED = "(removed)"
"""Text in place of a value that may be a secret."""
_SECRET = re.compile(r"pass|secret|token|credential|private|api_?key|pin$|user", re.IGNORECASE)


@dataclass(frozen=True)
class SettingRow:
    """One key of the settings with its value now and in a run. A value is None if the key is omitted. `stated` is True
    if the settings file states the key, and False if the default applies."""

    key: str
    now: Any
    in_run: Any
    stated: bool


def setting_rows(now: Settings, in_run: Mapping[str, Any] | None) -> tuple[SettingRow, ...]:
    """Return every key of the settings `now`, and of the settings `in_run` that the journal has of a run, in the order
    of the schema. Values that may be secrets are removed, but tell whether they are stated. Without a run, `in_run` of
    all rows is None."""
    current = dict(_leaves(without_secrets(now.model_dump(mode="json"))))
    stated = dict(_leaves(now.model_dump(mode="json", exclude_unset=True)))
    former = {} if in_run is None else dict(_leaves(without_secrets(in_run)))
    keys = dict.fromkeys((*current, *former))
    return tuple(SettingRow(key, current.get(key), former.get(key), key in stated) for key in keys)


def without_secrets(document: Any) -> Any:
    """Return a copy of a document in which a value is replaced by a marker if its key suggests a secret, and an address
    by its scheme and host.

    Values at any depth of the document are checked.
    """
    if isinstance(document, Mapping):
        return {
            key: REMOVED if _SECRET.search(str(key)) and value is not None else without_secrets(value)
            for key, value in document.items()
        }
    if isinstance(document, str) and "://" in document:
        return _origin(document)
    if isinstance(document, list):
        return [without_secrets(part) for part in document]
    return document


def _origin(url: str) -> str:
    """Return scheme and host of an address. Its user, path and query may be a secret, such as those of a webhook."""
    scheme, _, rest = url.partition("://")
    host = rest.partition("/")[0].partition("?")[0].rpartition("@")[2]
    return url if url == f"{scheme}://{host}" else f"{scheme}://{host}/{REMOVED}"


def _leaves(document: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in document.items():
        key = f"{above}{name}"
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{key}.")
        else:
            yield key, value
