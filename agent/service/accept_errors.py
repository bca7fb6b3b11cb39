"""Errors of accepting connections in the event loops of the HTTP and OPC UA servers.

asyncio retries by itself after a shortage of file handles, but it logs a traceback for every attempt, up to thousands
per second.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

import structlog

EPISODE_S: Final = 10.0
"""Failures with less than this time in s between them are one shortage, which is logged once. asyncio tries again after
1 s."""
log = structlog.get_logger()


class AcceptErrors:
    """Handler of the exceptions of an event loop. It logs a shortage of file handles or memory once; all other
    exceptions are left to the loop's own handler. `server` is the name of the server in the log."""

    def __init__(self, server: str) -> None:
        self._server = server
        self._last_s: float | None = None

    def install(self) -> None:
        """Handle the exceptions of the running event loop."""
        asyncio.get_running_loop().set_exception_handler(self)

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if not str(context.get("message")).startswith("socket.accept()"):
            loop.default_exception_handler(context)
            return
        now_s = loop.time()
        if self._last_s is None or now_s - self._last_s > EPISODE_S:
            log.error("no connection can be accepted", server=self._server, reason=str(context.get("exception")))
        self._last_s = now_s
