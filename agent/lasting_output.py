"""Standard output and standard error that can be written to even after their terminal or the reader of their pipe is
gone."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

GONE = frozenset({errno.EPIPE, errno.EIO})
"""Errors of a stream that nobody can read any more: the pipe has no reader, or the terminal has hung up."""


class LastingStream:
    """Text stream that discards what it can no longer write.

    A machine must be left safely although nobody sees it, so a message that cannot be shown is not an error. Once the
    terminal or the reader of the pipe is gone, the file descriptor of the stream refers to the null device, because
    libraries and the interpreter write to it as well. If `holds_result` is set, other errors are raised, such as that
    of a full disk: the result of a command must not be cut off without notice.
    """

    def __init__(self, stream: TextIO, *, holds_result: bool = False) -> None:
        self._stream = stream
        self._holds_result = holds_result

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except OSError as error:
            self._discard(error)
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._discard(error)

    def _discard(self, error: OSError) -> None:
        if error.errno not in GONE:
            if self._holds_result:
                raise error
            return
        with suppress(OSError, ValueError):  # a stream without a file descriptor
            null = os.open(os.devnull, os.O_WRONLY)
            try:
                os.dup2(null, self._stream.fileno())
            finally:
                os.close(null)


def lasting(stream: TextIO) -> TextIO:
    """Return a stream that writes to `stream` and discards what cannot be written."""
    return cast("TextIO", LastingStream(stream))


@contextmanager
def lasting_output() -> Iterator[None]:
    """Discard what can no longer be shown on standard output and standard error during the `with` block.

    Also a decorator of the function of a command. Standard output is taken for the result of the command, of which
    nothing is discarded as long as somebody can read it.
    """
    former = sys.stdout, sys.stderr
    output, errors = LastingStream(sys.stdout, holds_result=True), LastingStream(sys.stderr)
    sys.stdout, sys.stderr = cast("TextIO", output), cast("TextIO", errors)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = former
        output.flush()
        errors.flush()
