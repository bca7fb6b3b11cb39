"""Documents made from the trends of a machine, kept in its state directory over a restart of the service.

The fit of all series of a thousand runs takes seconds of the processor; after a restart with the same history, the same
documents would be made again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import structlog

from agent.files import write_atomically
from drivers.errors import InputError

log = structlog.get_logger()
T = TypeVar("T")


@dataclass(frozen=True)
class KeptDocuments:
    """Documents by name in the file `path`. They are valid for one `key`, which stands for everything from which they
    were made; those of another key are not read."""

    path: Path

    def read(self, key: object, kind: type[T]) -> dict[str, T]:
        """Return the documents of `key`, all of the type `kind`; none if there are none, or if the file cannot be read
        or contains something else."""
        head = _head(key)
        try:
            with self.path.open(encoding="utf-8") as file:
                if file.read(len(head)) != head:  # megabytes of another key are not decoded
                    return {}
                found = json.loads(head + file.read())["documents"]
        except (OSError, ValueError, KeyError, RecursionError):
            return {}  # they are made again
        if not isinstance(found, dict) or not all(isinstance(one, kind) for one in found.values()):
            return {}
        return found

    def write(self, key: object, documents: Mapping[str, Any]) -> None:
        """Replace the documents in the file. If the file cannot be written, the next start makes them again."""
        try:
            write_atomically(self.path, json.dumps({"key": _digest(key), "documents": documents}))
        except InputError as error:
            log.warning("trends are not kept", reason=error.message)


def _digest(key: object) -> str:
    return hashlib.sha256(repr(key).encode()).hexdigest()


def _head(key: object) -> str:
    """Return the text with which the file of `key` begins."""
    return json.dumps({"key": _digest(key)}).removesuffix("}")
