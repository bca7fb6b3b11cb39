"""Outbox: the notices that wait for their delivery, on the disk, so that a restart loses none.

The outbox also keeps the ids of the latest notices, so that the same occasion is not told twice when the service finds
it again after a restart.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Literal

import structlog
from pydantic import ValidationError

from agent.files import read_text, write_atomically
from agent.notifications.notice import Notice, StoredNotice
from drivers.errors import InputError
from twin.formats.toml_reading import StrictModel

log = structlog.get_logger()

FILE_NAME = "outbox.json"
MOST_WAITING = 200
MOST_IDS = 1000


class _StoredWaiting(StrictModel):
    notice: StoredNotice
    channels: tuple[str, ...]


class _StoredOutbox(StrictModel):
    version: Literal[1]
    ids: tuple[str, ...]
    waiting: tuple[_StoredWaiting, ...]


@dataclass(frozen=True)
class WaitingNotice:
    """Notice with the channels that have not delivered it yet."""

    notice: Notice
    channels: frozenset[str]


class Outbox:
    """Notices that wait, the oldest first. Any thread may use it. If the disk is full, the outbox goes on in memory and
    logs this once."""

    def __init__(self, directory: Path, channels: Collection[str], most_waiting: int = MOST_WAITING) -> None:
        """Read the notices that wait for one of `channels` from `directory`; those for other channels are dropped."""
        self._path = directory / FILE_NAME
        self._most_waiting = most_waiting
        self._lock = threading.Lock()
        self._unwritten = False
        self._ids, waiting = self._read()
        kept = (replace(one, channels=one.channels & frozenset(channels)) for one in waiting)
        self._waiting = [one for one in kept if one.channels]

    def put(self, notice: Notice, channels: Iterable[str], *, replaces: bool = False) -> bool:
        """Add a notice for `channels`. Return False if its id has been here already: it is then not added.

        If `replaces` is true, waiting notices of the same occasion give way to it. If the outbox is full, the oldest
        notice is dropped.
        """
        with self._lock:
            if notice.notice_id in self._ids:
                return False
            self._ids = [*self._ids, notice.notice_id][-MOST_IDS:]
            if replaces:
                self._waiting = [one for one in self._waiting if one.notice.occasion != notice.occasion]
            self._waiting.append(WaitingNotice(notice, frozenset(channels)))
            surplus, self._waiting = self._waiting[: -self._most_waiting], self._waiting[-self._most_waiting :]
            self._write()
        for one in surplus:
            log.warning("the outbox is full; a notice is dropped", notice=one.notice.subject, at=one.notice.at)
        return True

    def next_for(self, channel: str) -> Notice | None:
        """Return the oldest notice that waits for `channel`, or None."""
        with self._lock:
            return next((one.notice for one in self._waiting if channel in one.channels), None)

    def count(self, channel: str) -> int:
        with self._lock:
            return sum(channel in one.channels for one in self._waiting)

    def remove(self, notice: Notice, channel: str) -> None:
        """Note that `channel` has delivered or dropped the notice."""
        with self._lock:
            found = [
                replace(one, channels=one.channels - {channel}) if one.notice.notice_id == notice.notice_id else one
                for one in self._waiting
            ]
            self._waiting = [one for one in found if one.channels]
            self._write()

    def postpone(self, notice: Notice) -> None:
        """Let the notice wait behind the others, since its receiver has refused it."""
        with self._lock:
            self._waiting.sort(key=lambda one: one.notice.notice_id == notice.notice_id)
            self._write()

    def _read(self) -> tuple[list[str], list[WaitingNotice]]:
        """Return the stored ids and notices. A file that cannot be read is set aside, not deleted."""
        if not self._path.exists():
            return [], []
        try:
            stored = _StoredOutbox.model_validate_json(read_text(self._path))
        except (InputError, ValidationError) as error:
            log.warning("the outbox cannot be read and is set aside", file=str(self._path), reason=str(error))
            with suppress(OSError):  # a disk that cannot be written is found at the next notice
                self._path.replace(self._path.with_suffix(".damaged"))
            return [], []
        return list(stored.ids), [WaitingNotice(o.notice.notice(), frozenset(o.channels)) for o in stored.waiting]

    def _write(self) -> None:
        waiting = [{"notice": one.notice.as_json(), "channels": sorted(one.channels)} for one in self._waiting]
        document = {"version": 1, "ids": self._ids, "waiting": waiting}
        try:
            write_atomically(self._path, json.dumps(document))
        except InputError as error:
            if not self._unwritten:
                log.warning("the outbox cannot be written; a restart would lose its notices", reason=str(error))
            self._unwritten = True
            return
        self._unwritten = False


def is_older(notice: Notice, hours: float, now: datetime) -> bool:
    """Return True if the occasion of the notice was more than `hours` before `now`."""
    return now - datetime.fromisoformat(notice.at) > timedelta(hours=hours)
