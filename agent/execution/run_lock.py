"""One run at a time: an advisory lock on a file under the state directory, released by the kernel at any exit."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from agent.errors import Busy
from drivers.errors import ConfigurationError

FILE_NAME = "run.lock"


@contextmanager
def run_lock(directory: Path, run_id: str) -> Iterator[None]:
    """Own the machine for `run_id`; Busy names the run that owns it already."""
    with ownership(directory, f"run {run_id}"):
        yield


@contextmanager
def ownership(directory: Path, owner: str) -> Iterator[Ownership]:
    """Own the machine as `owner` (in words) for longer than one run; Busy names who owns it already."""
    with _opened(directory) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            handle.seek(0)
            other = handle.read().strip() or "another process"
            raise Busy(
                f"the machine is owned by {other}",
                hint="wait for it or abort it; two masters never move one machine",
                file=str(directory / FILE_NAME),
            ) from None
        owned = Ownership(handle, owner)
        yield owned
        owned.set_owner("")


class Ownership:
    """The lock, held; the file says for what."""

    def __init__(self, handle: TextIO, owner: str) -> None:
        self._handle = handle
        self._owner = owner
        self.set_owner(owner)

    @contextmanager
    def for_run(self, _: Path, run_id: str) -> Iterator[None]:
        """In place of `run_lock` for a run of whoever holds the lock already."""
        self.set_owner(f"run {run_id}")
        try:
            yield
        finally:
            self.set_owner(self._owner)

    def set_owner(self, owner: str) -> None:
        self._handle.truncate(0)
        self._handle.write(owner)
        self._handle.flush()


def _opened(directory: Path) -> TextIO:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        return (directory / FILE_NAME).open("a+", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(
            f"the state directory cannot be used: {error.strerror or error}",
            key="state_directory",
            hint="name a directory that this user may write to",
            file=str(directory),
        ) from error
