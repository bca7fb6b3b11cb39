"""Limits on the connections of the HTTP server, so that clients that keep connections open without a request do not
keep others out.

Uvicorn's own limit counts idle connections like requests and then answers every request with 503, an abort included.
This module ends connections instead: one that does not send its request in time, and the one that has waited for
longest if a new client finds all places taken.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

import h11
import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from agent.service.accept_errors import AcceptErrors

MAX_CONNECTIONS: Final = 160
"""Twice the number of requests that are processed at the same time (`agent.service.http.guard`), and well below the
1024 file handles that a process usually has."""
REQUEST_TIMEOUT_S: Final = 10.0
KEEP_ALIVE_S: Final = 5
BACKLOG: Final = 64
log = structlog.get_logger()


class LimitedConnection(H11Protocol):
    """HTTP/1.1 connection that must send its first request, and complete every request, within REQUEST_TIMEOUT_S."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._since_s = self.loop.time()
        self._set_deadline()
        if len(self.connections) > MAX_CONNECTIONS:
            self._make_room()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._set_deadline()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.conn.their_state is h11.SEND_BODY:  # the beginning of this request came with the one before
            self._set_deadline()

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_deadline()
        super().connection_lost(exc)

    @property
    def waits_for_client(self) -> bool:
        """True if no complete request has arrived that is still to be answered."""
        return self.conn.their_state in (h11.IDLE, h11.SEND_BODY)

    @property
    def waiting_since_s(self) -> float:
        """Instant of the event loop's clock at which the connection was made or its last request was complete."""
        return self._since_s

    def end(self) -> None:
        """Close the connection at once."""
        self.transport.abort()

    def _set_deadline(self) -> None:
        if not self.waits_for_client:
            self._since_s = self.loop.time()
            self._cancel_deadline()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(REQUEST_TIMEOUT_S, self.end)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _make_room(self) -> None:
        """End the connection that has waited for its client for longest; if none waits, the oldest one."""
        others: list[Any] = [other for other in self.connections if other is not self]
        longest = min(others, key=lambda other: (not other.waits_for_client, other.waiting_since_s))
        self.connections.discard(longest)
        longest.end()
        log.warning("connection ended", client=str(longest.client), reason="too many connections, idle for longest")


class LimitedServer(uvicorn.Server):
    """Uvicorn server whose event loop logs a shortage of file handles once."""

    async def startup(self, sockets: Any = None) -> None:
        AcceptErrors("http").install()
        await super().startup(sockets)
