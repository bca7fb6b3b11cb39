"""TCP server with its own threads. The simulator uses it for Modbus, for its control channel (actions of a person at
the machine) and for its time server.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable
from functools import partial

import structlog

from drivers.accept_loop import accepted, attended
from drivers.errors import ConfigurationError

LONGEST_LINE = 65536
log = structlog.get_logger()


class TcpServer:
    """TCP server that listens from its construction on. After `start` it calls the given function `serve(connection)`
    for each connection.

    If `one_client` is True, the connections are served one at a time: the next connection waits until the present one
    has closed, as with a PLC that has a single Modbus socket. An OSError raised by `serve` means that the peer has
    closed the connection. Raises ConfigurationError if the address is not available.
    """

    def __init__(
        self,
        name: str,
        address: tuple[str, int],
        serve: Callable[[socket.socket], None],
        *,
        one_client: bool = False,
    ) -> None:
        self._name = name
        self._serve = serve
        self._one_client = one_client
        self._connections: set[socket.socket] = set()
        self._guard = threading.Lock()
        self._closed = threading.Event()
        try:
            self._listener = socket.create_server(address)
        except (OSError, OverflowError) as error:
            raise ConfigurationError(
                f"cannot listen for {name} on {address[0]}:{address[1]}: {error}",
                hint="choose a free port (0 for any) and an address of this computer",
            ) from error
        self._thread = threading.Thread(target=self._accept_forever, name=name, daemon=True)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which the server listens. If port 0 was requested, this is the port that the
        system chose.
        """
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Stop listening and close all connections; return once no further connection can be served."""
        with self._guard:
            self._closed.set()
            for connection in (self._listener, *self._connections):
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
        if self._thread.ident is not None:
            self._thread.join(timeout=5.0)
        self._listener.close()

    def _accept_forever(self) -> None:
        for connection, _ in accepted(self._listener, self._closed, self._name):
            if self._one_client:
                self._attend(connection)
            else:
                attended(connection, partial(self._attend, connection), self._name)

    def _attend(self, connection: socket.socket) -> None:
        with connection:
            with self._guard:
                if self._closed.is_set():
                    return
                self._connections.add(connection)
            try:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._serve(connection)
            except OSError as error:
                log.info("client disconnected", server=self._name, reason=str(error))
            finally:
                with self._guard:
                    self._connections.discard(connection)


def serve_lines(connection: socket.socket, answer: Callable[[bytes], bytes]) -> None:
    """Answer each received line with one line until the peer closes the connection or sends a line that is too long."""
    buffer = b""
    while chunk := connection.recv(LONGEST_LINE):
        *lines, buffer = (buffer + chunk).split(b"\n")
        for line in lines:
            connection.sendall(answer(line) + b"\n")
        if len(buffer) > LONGEST_LINE:
            log.warning("connection closed", reason="line too long", limit=LONGEST_LINE)
            return
