"""Sequence number of the last accepted panel command, stored on disk.

A panel that reconnects, or a PLC that repeats its command block, must not start a run a second time. A restart of the
service must not make an old sequence number valid again. The number is therefore stored durably before the command is
executed: after a power failure a command may be lost, but it is never executed twice. If the number cannot be stored,
only commands that stop the machine are executed.
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
    """Return the sequence number that follows `number`. The number 0 is never used, because registers that have been
    cleared contain it."""
    return number % MAX_SEQUENCE + 1


class SequenceLedger:
    """Stored sequence number and content of the last accepted command. Only one thread at a time may write; the command
    handler ensures this.

    Raise ConfigurationError if the stored file is invalid.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / FILE_NAME
        self.accepted, self.content = self._load()

    def record(self, number: int, content: Content) -> None:
        """Store the sequence number and content of a command durably. If they cannot be stored, raise InputError and
        leave the stored values unchanged."""
        write_atomically(self._path, json.dumps({"accepted": number, "content": list(content)}) + "\n")
        self.keep(number, content)

    def keep(self, number: int, content: Content) -> None:
        """Keep the sequence number and content of a command until the service ends, without storing them."""
        self.accepted, self.content = number, content

    def _load(self) -> tuple[int, Content | None]:
        """Return the stored number and content. If nothing is stored, return a random number and None, so that a number
        left in a panel's registers is unlikely to be accepted as the next one.
        """
        if not self._path.exists():
            return _random_start(), None
        try:
            stored = json.loads(read_text(self._path))
            accepted, content = stored["accepted"], tuple(stored["content"])
            if not (isinstance(accepted, int) and 1 <= accepted <= MAX_SEQUENCE):
                raise ValueError(f"accepted is {accepted!r}")
        except (InputError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise ConfigurationError(
                f"the recorded sequence number of the gateway cannot be read: {error}",
                hint="check the file, or remove it: every panel must then read accepted_sequence again",
                file=str(self._path),
            ) from error
        return accepted, content


def _random_start() -> int:
    return random.SystemRandom().randint(1, MAX_SEQUENCE)
