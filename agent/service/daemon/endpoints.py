"""Endpoints, which connect clients to the `Control` of the service, and extensions of the HTTP application.

This is the only module that knows every endpoint. If an endpoint needs an optional dependency, it imports it when it is
opened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Protocol

import structlog

from agent.errors import EndpointUnavailable
from agent.service.alarms import alarm_of
from agent.service.control import Alarm, Control
from agent.service.gateway.endpoint import GatewayEndpoint
from agent.service.http.app import Extension
from agent.service.http.metrics import mount_metrics
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.service.page.static_files import mount_page
from agent.service.state.idle_alarms import ENDPOINT
from agent.service.token import read_token, token_path
from agent.settings.schema import Settings

log = structlog.get_logger()


class Endpoint(Protocol):
    """Endpoint of the service. `start` returns once clients can connect, or raises an error. `alive` is False if the
    endpoint has ended by itself. `stop` returns once the endpoint no longer serves any client."""

    @property
    def name(self) -> str: ...

    @property
    def alive(self) -> bool: ...

    def start(self, control: Control) -> None: ...

    def stop(self) -> None: ...


@contextmanager
def open_endpoints(
    endpoints: Sequence[Endpoint], control: Control, leave_out: Callable[[Alarm], object]
) -> Iterator[Sequence[Endpoint]]:
    """Open all endpoints, yield those that are open, and close them at the end of the `with` block.

    An endpoint that raises EndpointUnavailable is left out, and `leave_out` is called with an alarm that says so. If it
    raises another error, close those that are already open and raise it.
    """
    with ExitStack() as stack:
        opened = []
        for endpoint in endpoints:
            try:
                endpoint.start(control)
            except EndpointUnavailable as error:
                log.error("the service goes on without an endpoint", endpoint=endpoint.name, reason=str(error))
                leave_out(_left_out(endpoint.name, error))
                continue
            stack.callback(endpoint.stop)
            opened.append(endpoint)
        yield opened


def _left_out(name: str, error: EndpointUnavailable) -> Alarm:
    alarm = alarm_of(error)
    text = f"the service goes on without {name}: {alarm.text}"
    return replace(alarm, text=text, where={ENDPOINT: name, **alarm.where})


def further_endpoints(settings: Settings) -> Sequence[Endpoint]:
    """Return the endpoints other than HTTP that are enabled in the settings, in the order in which they are opened."""
    endpoints: list[Endpoint] = []
    if settings.opcua.enabled:
        endpoints.append(OpcUaEndpoint(settings.opcua, settings.state_directory, read_token(token_path(settings))))
    if settings.gateway.enabled:
        endpoints.append(GatewayEndpoint(settings.gateway, settings.state_directory))
    return endpoints


def http_extensions(_: Settings) -> Sequence[Extension]:
    """Return the functions that add pages and routers to the HTTP application. The access check of the HTTP application
    (`agent.service.http.guard`) also checks the requests for these pages and routers."""
    return (mount_page, mount_metrics)
