"""Interface of the endpoints that connect clients to the one `Control`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Protocol

from agent.service.control import Control


class Endpoint(Protocol):
    """Endpoint: `start` returns when it accepts clients, or raises; `stop` returns when no client is served any
    more."""

    @property
    def name(self) -> str: ...

    def start(self, control: Control) -> None: ...

    def stop(self) -> None: ...


@contextmanager
def open_endpoints(endpoints: Sequence[Endpoint], control: Control) -> Iterator[None]:
    """Open all endpoints for the block; if one fails to open, close those already open."""
    with ExitStack() as stack:
        for endpoint in endpoints:
            endpoint.start(control)
            stack.callback(endpoint.stop)
        yield
