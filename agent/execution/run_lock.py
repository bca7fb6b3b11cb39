"""Advisory lock on a file in the state directory, which permits one run at a time.

The operating system releases the lock when the process exits.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from agent.errors import Busy
from agent.files import create_directory
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

FILE_NAME = "run.lock"


@contextmanager
def run_lock(directory: Path, run_id: str) -> Iterator[None]:
    """Lock the machine for the run `run_id` during the `with` block. The lock is a file in the state directory
    `directory`.

    Raises Busy, which names the present owner, if the machine is already owned.
    """
    with ownership(directory, f"run {run_id}"):
        yield


@contextmanager
def ownership(directory: Path, owner: str) -> Iterator[Ownership]:
    """Lock the machine during the `with` block, which may contain several runs. The lock is a file in the state
    directory `directory`.

    `owner` describes in words who holds the lock. Raises Busy, which names the present owner, if the machine is already
    locked.
    """
    with _open_lock_file(directory) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            handle.seek(0)
            other = handle.read().strip() or "another process"
            raise Busy(
                f"the machine is owned by {other}",
                hint="wait for it or abort it; only one process may move the machine",
                file=str(directory / FILE_NAME),
            ) from None
        held = Ownership(handle, owner)
        yield held
        held.set_owner("")


class Ownership:
    """Acquired lock on the machine. The lock file contains a text that describes the owner, such as the run in
    progress.
    """

    def __init__(self, handle: TextIO, owner: str) -> None:
        self._handle = handle
        self._owner = owner
        self.set_owner(owner)

    @contextmanager
    def for_run(self, _: Path, run_id: str) -> Iterator[None]:
        """Name the run `run_id` as owner of the machine in the lock file during the `with` block.

        A caller that already holds the lock calls this method instead of the function `run_lock`.
        """
        self.set_owner(f"run {run_id}")
        try:
            yield
        finally:
            self.set_owner(self._owner)

    def set_owner(self, owner: str) -> None:
        """Write the text that describes the owner. It is only shown to people: the lock holds also if the disk is full
        and the text is lost."""
        with suppress(OSError):
            os.ftruncate(self._handle.fileno(), 0)
            os.write(self._handle.fileno(), owner.encode())


def _open_lock_file(directory: Path) -> TextIO:
    try:
        create_directory(directory)
        return (directory / FILE_NAME).open("a+", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(
            f"the state directory cannot be used: {cause_of(error)}",
            key="state_directory",
            hint="set a directory that this user may write to",
            file=str(directory),
        ) from error
