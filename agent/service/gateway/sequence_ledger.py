"""The number of the last command that was looked at, kept on the disk.

A panel that reconnects, or a PLC that writes its command block again and again, must not start a run a second time,
and neither must the restart of this service make an old number new. So the number is durable before its command is
given to anybody: after a power cut a command may be lost, it can never be given twice.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Final

import structlog

from agent.files import read_text, write_atomically
from drivers.errors import ConfigurationError, InputError

FILE_NAME: Final = "gateway-sequence.json"
MAX_SEQUENCE: Final = 0xFFFF
log = structlog.get_logger()

Content = tuple[int | str | None, ...]


def next_sequence(number: int) -> int:
    """The number after this one; 0 is never used, because cleared registers hold it."""
    return number % MAX_SEQUENCE + 1


class SequenceLedger:
    """Which number was accepted last, and with what content. One writer (the handler) at a time."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / FILE_NAME
        self.accepted, self.content = self._load()

    def record(self, number: int, content: Content) -> None:
        """Durable when this returns. Raises InputError where it cannot be written; nothing has changed then."""
        write_atomically(self._path, json.dumps({"accepted": number, "content": list(content)}) + "\n")
        self.accepted, self.content = number, content

    def _load(self) -> tuple[int, Content | None]:
        """Where nothing is recorded the count begins anywhere, so that no register left over from before fits."""
        if not self._path.exists():
            return _random_start(), None
        try:
            stored = json.loads(read_text(self._path))
            accepted, content = stored["accepted"], tuple(stored["content"])
            if not (isinstance(accepted, int) and 1 <= accepted <= MAX_SEQUENCE):
                raise ValueError(f"accepted is {accepted!r}")
        except (InputError, ValueError, KeyError, TypeError) as error:
            raise ConfigurationError(
                f"what the gateway recorded cannot be read: {error}",
                hint="look at the file; remove it and every panel has to read accepted_sequence anew",
                file=str(self._path),
            ) from error
        return accepted, content


def _random_start() -> int:
    return random.SystemRandom().randint(1, MAX_SEQUENCE)
