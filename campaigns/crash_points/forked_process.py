"""Forked processes that carry out a command of `volcal` or serve a simulated machine.

The parent has imported everything, so that a start takes no second. It must have no threads.
"""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from agent.cli.main import main as volcal

Found = TypeVar("Found")
PATIENCE_S = 300.0
POLL_S = 0.01


def wait_for(condition: Callable[[], Found | None], what: str, every_s: float = POLL_S) -> Found:
    """Call `condition` until its result is true, and return it. Raise TimeoutError with `what` if that takes longer
    than `PATIENCE_S`."""
    ends_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > ends_s:
            raise TimeoutError(f"waited in vain for {what}")
        time.sleep(every_s)
    return found


class ForkedProcess:
    """Child of this process that calls `work` and then ends; its output is appended to the file `log`."""

    def __init__(self, work: Callable[[], None], log: Path) -> None:
        self.log = log
        self._status: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            _become(work, log)

    @property
    def ended(self) -> bool:
        """True if the child has ended, by itself or by a signal."""
        if self._status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._status = status
        return self._status is not None

    @property
    def exit_code(self) -> int:
        """Exit code of the child, which has ended; that of a signal is its negative number."""
        assert self._status is not None
        return os.waitstatus_to_exitcode(self._status)

    def await_end(self) -> int:
        wait_for(lambda: self.ended, f"the end of process {self.pid}")
        return self.exit_code

    def kill(self) -> None:
        """Kill the child unless it has ended."""
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)
            self.await_end()


def forked_command(arguments: list[str], log: Path, prepare: Callable[[], None] = lambda: None) -> ForkedProcess:
    """Start the command `volcal` with these arguments in a process of its own, after `prepare` in that process."""

    def work() -> None:
        prepare()
        volcal(arguments)

    return ForkedProcess(work, log)


def _become(work: Callable[[], None], log: Path) -> None:
    """Carry out `work` as the forked child, and end it without anything that its parent has left to do."""
    code = 0
    try:
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(output, 1)
        os.dup2(output, 2)
        work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:  # noqa: BLE001  a child must never continue as its parent
        traceback.print_exc()
        code = 1
    finally:
        os._exit(code)
