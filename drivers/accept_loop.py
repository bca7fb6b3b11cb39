"""Accept loop of a TCP server that has a thread of its own. It outlives a shortage of file handles."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Final

import structlog

RETRY_S: Final = 0.2
"""Pause in s after a failed accept. The waiting client stays in the queue of the listener, so the next accept would
fail at once."""
LISTENER_LOST: Final = frozenset({errno.EBADF, errno.EINVAL, errno.ENOTSOCK, errno.EOPNOTSUPP})
"""Errors of accept(2) that concern the listener itself. All others concern one client, the network or a shortage."""
log = structlog.get_logger()


def accepted(listener: socket.socket, stopped: threading.Event, server: str) -> Iterator[tuple[socket.socket, str]]:
    """Yield every connection that `listener` accepts, with the host of its peer, until `stopped` is set.

    A shortage of file handles or memory is logged once; accepting continues as soon as the shortage is over. If the
    listener itself is lost although `stopped` is not set, the error is logged and the iteration ends. `server` is the
    name of the server in the log.
    """
    failing = False
    while not stopped.is_set():
        try:
            connection, peer = listener.accept()
        except OSError as error:
            if stopped.is_set():
                return
            if error.errno in LISTENER_LOST:
                log.error("the server no longer listens", server=server, reason=str(error))
                return
            if not failing:
                log.error("no connection can be accepted", server=server, reason=str(error))
            failing = True
            stopped.wait(RETRY_S)
            continue
        if failing:
            failing = False
            log.warning("connections are accepted again", server=server)
        yield connection, str(peer[0])


def attended(connection: socket.socket, attend: Callable[[], None], server: str) -> bool:
    """Call `attend` in a new thread and return True. If the system starts no further thread, log that, close
    `connection` and return False, so that the accept loop continues."""
    try:
        threading.Thread(target=attend, name=f"{server} client", daemon=True).start()
    except RuntimeError as error:
        log.error("connection closed", server=server, reason=str(error))
        connection.close()
        return False
    return True
