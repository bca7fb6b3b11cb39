"""Memory of the service process that the C library holds but nobody uses.

The C library of most Linux systems, glibc, gives each thread an arena of its own, up to eight arenas per processor
core, and keeps what is freed in an arena for the threads that use this arena later. Each run has a thread of its own,
which plans and identifies. The memory that this needs at its peak would therefore be held several times, once in each
arena that a run has had by chance.
"""

from __future__ import annotations

import ctypes

import structlog

log = structlog.get_logger()

_M_ARENA_MAX = -8
"""Number of the parameter in malloc.h."""


def share_one_heap() -> None:
    """Let all threads of this process use the same arena. Call it before the first other thread is started.

    The threads do not wait for each other more than before: Python runs one of them at a time, and large arrays are not
    in an arena. Without glibc this function has no effect.
    """
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None and not set_option(_M_ARENA_MAX, 1):
        log.warning("the arenas of the C library cannot be limited; the service may use more memory")


def release_free_memory() -> None:
    """Give the memory that is free in this process back to the operating system. Without glibc this function has no
    effect."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
