"""Interface of the endpoints, which connect clients to the `Control` of the service."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Protocol

from agent.service.control import Control


class Endpoint(Protocol):
    """Endpoint of the service. `start` returns once clients can connect, or raises an error. `stop` returns once the
    endpoint no longer serves any client."""

    @property
    def name(self) -> str: ...

    def start(self, control: Control) -> None: ...

    def stop(self) -> None: ...


@contextmanager
def open_endpoints(endpoints: Sequence[Endpoint], control: Control) -> Iterator[None]:
    """Open all endpoints, and close them at the end of the `with` block.

    If an endpoint cannot be opened, close those that are already open and raise its error.
    """
    with ExitStack() as stack:
        for endpoint in endpoints:
            endpoint.start(control)
            stack.callback(endpoint.stop)
        yield
