"""Sockets of the gateway. Each panel has a thread of its own, so that no panel delays another one."""

from __future__ import annotations

import contextlib
import ipaddress
import itertools
import socket
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import structlog

from agent.service.gateway.frames import (
    HEADER,
    ExceptionCode,
    FramingError,
    RegisterTable,
    answer_frame,
    answer_request,
    body_length,
)
from drivers.accept_loop import accepted, attended
from drivers.errors import ConfigurationError
from drivers.foreign_errors import cause_of

JOIN_S: Final = 5.0
log = structlog.get_logger()

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


class _Client:
    """A connection, and the number of its last request. Requests are numbered consecutively over all connections.

    The number shows which connection has been idle for longest, so that no times need to be stored.
    """

    def __init__(self, connection: socket.socket, peer: str) -> None:
        self.connection = connection
        self.peer = peer
        self.last_request = 0

    def disconnect(self) -> None:
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)


class ModbusServer:
    """Modbus TCP server. It listens from its construction and responds from `start` to `stop`.

    A connection from an address outside `allowed` is closed. If a client connects while `max_clients` are connected,
    the connection that has been idle for longest is closed, as in the Modbus implementation guide (4.2.2).

    A connection is closed if its client sends nothing for `idle_timeout_s`, takes longer than `idle_timeout_s` to read
    a response, or sends bytes that are not Modbus. Raise ConfigurationError if the address cannot be bound.
    """

    def __init__(
        self,
        address: tuple[str, int],
        allowed: Sequence[Network],
        session: Callable[[], RegisterTable],
        *,
        max_clients: int = 8,
        idle_timeout_s: float = 60.0,
    ) -> None:
        self._allowed = allowed
        self._session = session
        self._max_clients = max_clients
        self._idle_s = idle_timeout_s
        self._guard = threading.Lock()
        self._clients: set[_Client] = set()
        self._requests = itertools.count(1)
        self._stopped = threading.Event()
        self._listener = _listen(address)
        self._thread = threading.Thread(target=self._accept_forever, name="gateway", daemon=True)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which the server listens."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    @property
    def alive(self) -> bool:
        """True as long as further panels can connect."""
        return self._thread.is_alive()

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Close all connections. After this method has returned, the server executes no further request."""
        with self._guard:
            self._stopped.set()
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            for client in self._clients:
                client.disconnect()
        if self._thread.ident is not None:
            self._thread.join(JOIN_S)
        self._listener.close()

    def _accept_forever(self) -> None:
        for connection, peer in accepted(self._listener, self._stopped, "panel gateway"):
            client = _Client(connection, peer)
            if not self._admit(client):
                connection.close()
            elif not attended(connection, partial(self._handle_client, client), "panel gateway"):
                self._forget(client)

    def _admit(self, client: _Client) -> bool:
        if not self._is_allowed(client.peer):
            log.warning("connection refused", peer=client.peer, reason="not in gateway.clients")
            return False
        with self._guard:
            if self._stopped.is_set():
                return False
            if len(self._clients) >= self._max_clients:
                self._make_room()
            client.last_request = next(self._requests)
            self._clients.add(client)
        return True

    def _make_room(self) -> None:
        idlest = min(self._clients, key=lambda client: client.last_request)
        log.warning("panel disconnected", peer=idlest.peer, reason="too many connections, idle for longest")
        self._clients.discard(idlest)
        idlest.disconnect()

    def _is_allowed(self, peer: str) -> bool:
        address = ipaddress.ip_address(peer.partition("%")[0])
        mapped = getattr(address, "ipv4_mapped", None)
        return any((mapped or address) in network for network in self._allowed)

    def _handle_client(self, client: _Client) -> None:
        with client.connection, structlog.contextvars.bound_contextvars(panel=client.peer):
            try:
                client.connection.settimeout(self._idle_s)
                client.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._serve(client)
            except (OSError, FramingError) as error:
                log.info("connection to panel ended", reason=str(error))
            finally:
                self._forget(client)

    def _forget(self, client: _Client) -> None:
        with self._guard:
            self._clients.discard(client)

    def _serve(self, client: _Client) -> None:
        table = self._session()
        while (header := _receive(client.connection, HEADER.size)) is not None:
            request = _receive(client.connection, body_length(header))
            if request is None or self._stopped.is_set():
                return
            client.last_request = next(self._requests)
            client.connection.sendall(answer_frame(header, _answer(request, table)))


def _answer(request: bytes, table: RegisterTable) -> bytes:
    """Return the response to a request. An unexpected error is answered with an exception response, so that the
    connection remains open.
    """
    try:
        return answer_request(request, table)
    except Exception:
        log.exception("a panel's request failed")
        return bytes((request[0] | 0x80, ExceptionCode.FAILURE))


def _receive(connection: socket.socket, size: int) -> bytes | None:
    """Return exactly `size` bytes, or None if the peer closed the connection before it had sent them."""
    data = b""
    while len(data) < size:
        if not (chunk := connection.recv(size - len(data))):
            return None
        data += chunk
    return data


def _listen(address: tuple[str, int]) -> socket.socket:
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    try:
        return socket.create_server(address, family=family)
    except (OSError, OverflowError) as error:
        raise ConfigurationError(
            f"cannot listen for panels on {address[0]}:{address[1]}: {cause_of(error)}",
            hint="choose a free port (below 1024 needs the privilege) and an address of this computer",
            key="gateway.host, gateway.port",
        ) from error
