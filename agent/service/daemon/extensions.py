"""Endpoints of the service other than HTTP, and extensions of the HTTP application.

If an endpoint needs an optional dependency, it imports the dependency when it is opened.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.service.daemon.endpoints import Endpoint
from agent.service.gateway.endpoint import GatewayEndpoint
from agent.service.http.app import Extension
from agent.service.http.metrics import mount_metrics
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.service.page.static_files import mount_page
from agent.service.token import read_token, token_path
from agent.settings.schema import Settings


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
